"""The other headings that an object may have, and which views would tell them from its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from factors.state import ObjectState
from objgraph.active.surface_sample import SurfaceSample, sample_surface
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.surface import metric_sdf_jacobian
from objgraph.errors import SolveError
from objgraph.priors.shape_prior import ShapePrior

_LIKELY = 0.02
"""Probability below which a heading is not asked about."""


@dataclass(frozen=True, eq=False)
class OtherHeading(SurfaceSample):
    """The object as it would be if it stood turned."""

    probability: float
    square_distance: float
    """Mean over the box's corners of the squared distance from where they are as the object was found, square metres."""
    to_own: Float[np.ndarray, "m"]
    """Signed distances of `points` to the object as it was found, metres."""
    of_own: Float[np.ndarray, "n"]
    """Signed distances of that object's points to this one, metres."""


def other_headings(
    prior: ShapePrior,
    state: ObjectState,
    own: SurfaceSample,
    turns: HeadingModes,
    corners: Float[np.ndarray, "8 3"],
    resolution: int,
    seed: int,
) -> tuple[OtherHeading, ...]:
    """Those that are likely enough; `corners` are canonical ones of the box."""
    found = []
    for probability, turned in zip(turns.probability[1:], turns.states[1:], strict=False):
        if probability < _LIKELY or turned is None:
            continue
        try:
            surface = sample_surface(prior, turned, len(own.points), resolution, seed)
        except SolveError:  # what has no surface shows nothing that would tell it from the object's own
            continue
        found.append(
            OtherHeading(
                **vars(surface),
                probability=float(probability),
                square_distance=_square_distance(state, turned, corners),
                to_own=metric_sdf_jacobian(prior.decoder, state, surface.points)[0].numpy(),
                of_own=metric_sdf_jacobian(prior.decoder, turned, own.points)[0].numpy(),
            )
        )
    return tuple(found)


def _square_distance(one: ObjectState, other: ObjectState, corners: Float[np.ndarray, "8 3"]) -> float:
    return float(np.square(one.to_world(corners) - other.to_world(corners)).sum(axis=1).mean())


def risk(probability: float, others: Sequence[OtherHeading], divergences: Sequence[float]) -> float:
    """Bound on the mean square error of the corners that believing in the wrong heading makes, square metres.

    Two hypotheses of Gaussian measurements between which the divergence is D nats are mistaken for each other with at
    most sqrt(p q) exp(-D / 4) (Kailath, "The divergence and Bhattacharyya distance measures in signal selection", 1967).
    """
    return sum(
        float(np.sqrt(probability * other.probability)) * np.exp(-nats / 4) * other.square_distance
        for other, nats in zip(others, divergences, strict=True)
    )
