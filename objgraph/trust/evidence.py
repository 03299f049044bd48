"""What an estimate and the views it was made from show, without any truth, of how far it can be trusted."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
import torch
from jaxtyping import Float

from factors import checks
from factors.state import ObjectState
from objgraph.covariance.sides import seen_sides, seen_vertices
from objgraph.errors import CovarianceError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.geometry.frames import transformed
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior

OFF_M = 0.03
"""A seen point farther than this from the surface is not on it."""
_DEEPEST_M = 0.2
"""How far inside the surface a seen-through ray counts at most."""
_REACH_M = 1.0
"""Before and behind the object that far of a ray is looked at."""
_STEPS = 40


@dataclass(frozen=True)
class Evidence:
    """Numbers that tell good estimates from bad ones; none is calibrated, and each says what it can alone.

    Raises:
        CovarianceError: one of them is not finite.
    """

    seen: float
    """Share of the estimated surface that has a seen point near it."""
    heading: float
    """Probability of its heading among those that were solved; one where no other had a chance."""
    guess: float
    """The first guess's probability of the heading it held for likeliest; one where the prior has no first guess."""
    moved: float
    """Distance of the estimate's centre from the first guess's, over the object's diagonal."""
    off: float
    """Share of the seen points that are not on the estimated surface."""
    through: float
    """Mean depth that rays which saw past the object go through the estimate, over its diagonal."""
    size: float
    """How many standard deviations its size is from the category's."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = checks.number(
                f"the evidence '{field.name}'", getattr(self, field.name), error=CovarianceError
            )
            object.__setattr__(self, field.name, float(value))

    def to_json(self) -> dict[str, float]:
        return asdict(self)


NAMES = tuple(field.name for field in fields(Evidence))


def evidence_of(
    task: EstimationTask, estimate: Estimate, vertices_world: Float[np.ndarray, "v 3"]
) -> tuple[Evidence, Float[np.ndarray, "3 2"]]:
    """The evidence for an estimate of a task, and the share of each side of its box that was seen (`seen_sides`).

    `vertices_world` are those of its surface, metres.
    """
    prior, state = task.prior, estimate.state
    extents = np.ptp(state.to_object(vertices_world), axis=0) * state.scale
    diagonal = float(np.linalg.norm(extents))
    points = np.concatenate([view.points_world for view in task.views])
    share = np.concatenate([view.points_share for view in task.views])
    measured = np.isfinite(points).all(axis=1)
    points, share = points[measured], share[measured]
    away = np.abs(_distance(prior, state, points)) > OFF_M
    start = task.starts[0].T_world_object.translation()
    seen = seen_vertices(vertices_world, points)
    stands = task.floor is not None and prior.feet is not None
    evidence = Evidence(
        seen=float(seen.mean()),
        heading=1.0 if estimate.turns is None else float(estimate.turns.probability[0]),
        guess=max(task.chances, default=1.0),
        moved=float(np.linalg.norm(state.T_world_object.translation() - start)) / diagonal,
        off=float(share @ away / max(share.sum(), 1e-9)),
        through=_through(prior, state, task.views) / diagonal,
        size=abs(float(np.log(diagonal / prior.size_mean))) / prior.size_log_sigma,
    )
    return evidence, seen_sides(state, vertices_world, seen, stands)


def _through(prior: ShapePrior, state: ObjectState, views: Sequence[ObjectView]) -> float:
    """Mean of the greatest depth below the surface along rays that pass beside the object, as far as they saw, metres."""
    deepest = [np.zeros(0)]
    for view in views:
        free = ~view.rays.hit
        at, end = view.rays.depth[free], view.rays.end[free]
        along = np.linspace(np.maximum(at - _REACH_M, 0), at + _REACH_M, _STEPS, axis=1)
        p_camera = view.rays.directions_camera[free][:, None] * along[..., None]
        p_world = transformed(view.T_world_camera.matrix(), p_camera.reshape(-1, 3))
        inside = -_distance(prior, state, p_world).reshape(along.shape)
        deepest.append(np.where(along < end[:, None], inside, 0.0).max(axis=1, initial=0.0))
    every = np.concatenate(deepest).clip(0.0, _DEEPEST_M)
    return float(every.mean()) if len(every) else 0.0


def _distance(
    prior: ShapePrior, state: ObjectState, p_world: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    """Signed distance from the surface, metres, to first order in how the scales differ."""
    like = prior.decoder.like
    with torch.no_grad():
        sdf = prior.decoder(
            torch.as_tensor(state.to_object(p_world)).to(like),
            torch.as_tensor(state.code).to(like)[None],
            torch.zeros(len(p_world), dtype=torch.long, device=like.device),
        )
    return sdf.reshape(-1).cpu().double().numpy() * float(np.exp(state.log_scale.mean()))
