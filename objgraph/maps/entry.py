"""From an estimate to an object of the map: its mesh, what is known of it, and where it is from."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from factors.state import ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.surface import surface_sigma
from objgraph.errors import ObjectGraphError, SolveError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.maps.mapped_object import MappedObject, PriorReference
from objgraph.observation.sampling import ObjectView
from objgraph.priors.mesh import RESOLUTION, extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.trust.calibration import Calibration
from objgraph.trust.judge import judge_estimate

log = logging.getLogger(__name__)


class Numbered(Protocol):
    """What a map tells objects by: an `Instance` of a scan, or an object of a graph."""

    @property
    def id(self) -> int: ...

    @property
    def category(self) -> str: ...


def map_entry(
    instance: Numbered,
    prior: ShapePrior,
    estimate: Estimate,
    views: Sequence[ObjectView],
    resolution: int = RESOLUTION,
) -> MappedObject:
    """The object as the map has it, its mesh cut at `resolution` cells along an edge of the canonical cube.

    Raises:
        SolveError: the estimate has no covariance, or the code no surface.
    """
    state, covariance = estimate.state, estimate.covariance
    if covariance is None:
        raise SolveError(
            f"{instance.category} {instance.id}: the estimator gives no covariance, which the map needs"
        )
    mesh = extract_mesh(prior.decoder, state.code, resolution=resolution)
    vertices = np.asarray(mesh.vertices)
    return MappedObject(
        instance.id,
        instance.category,
        "mapped",
        T_world_object=state.T_world_object.matrix(),
        scale=state.scale,
        code=state.code,
        covariance=covariance.rigid,
        code_sigma=np.sqrt(np.diag(covariance.code)),
        **_spent(estimate),
        views=tuple(view.frame for view in views),
        cameras=np.reshape([view.T_world_camera.matrix() for view in views], (-1, 4, 4)),
        size_m=state.scale * mesh.extents,
        turns=None if estimate.turns is None else estimate.turns.probability,
        turned=None if estimate.turns is None else _turned(state, estimate.turns),
        prior=_reference(prior),
        vertices=state.to_world(vertices),
        faces=np.asarray(mesh.faces),
        vertex_sigma=surface_sigma(prior.decoder, state, covariance.times(prior.surface_misfit), vertices),
        joint_covariance=covariance.matrix,
    )


def failed_entry(
    instance: Numbered, error: ObjectGraphError, seconds: Mapping[str, float] | None = None
) -> MappedObject:
    """An object that could not be mapped, and why; it is logged, too."""
    log.warning("%s %d could not be mapped: %s", instance.category, instance.id, error)
    return MappedObject(
        instance.id, instance.category, "failed", str(error), seconds_by_stage=dict(seconds or {})
    )


def with_trust(
    entry: MappedObject, task: EstimationTask, estimate: Estimate, calibration: Calibration
) -> MappedObject:
    """An entry of `map_entry` with a verdict and the box with its calibrated covariance; as it is where the calibration knows
    nothing of such objects."""
    found = None if entry.vertices is None else judge_estimate(task, estimate, entry.vertices, calibration)
    if found is None:
        return entry
    return replace(
        entry,
        trust=found.trust,
        box_centre=found.box.T_world_box.translation(),
        box_extents=found.box.extents,
        box_covariance=found.box.covariance.matrix,
    )


def _turned(state: ObjectState, turns: HeadingModes) -> Float[np.ndarray, "4 9+l"] | None:
    """As the map has them."""
    if not turns.states:
        return None
    return np.array([state.local_coordinates(state if other is None else other) for other in turns.states])


def _spent(estimate: Estimate) -> dict[str, Any]:
    """Costs and what they took, which an object of a graph that was solved as a whole has none of."""
    names = ("cost_initial", "cost_final", "linearizations", "error_evaluations")
    return {} if np.isnan(estimate.cost_final) else {name: getattr(estimate, name) for name in names}


def _reference(prior: ShapePrior) -> PriorReference:
    name = prior.card["fallback"] if prior.is_fallback else prior.category
    return PriorReference(name, prior.digest, prior.is_fallback)
