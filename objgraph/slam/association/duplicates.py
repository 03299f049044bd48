"""Mapped objects that are one and the same thing."""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree

from factors.rays import BOX_HALF_SIZE
from factors.sdf import metres_per_unit, query_points
from factors.state import POSE_DOF, RIGID_DOF
from objgraph.covariance.quantile import squared_limit
from objgraph.errors import FactorError, SolveError
from objgraph.geometry.boxes import OrientedBox, box_iou
from objgraph.priors.categories import category_of
from objgraph.slam.association.decode import Asked, decode
from objgraph.slam.association.types import AssociationConfig, MappedCandidate, Merge

_LOG = logging.getLogger(__name__)

_PROJECTIONS = 6
"""Newton steps from a random point of the canonical box onto the surface."""
_ON_SURFACE = 0.01
"""Canonical units from the surface within which such a point has arrived."""

_ROUNDING = 1e-12
"""Of two variances, what a difference that does not vary comes out as."""
_SAME_PLACE = 1e-9
"""Metres."""

JointPoses = Callable[[int, int], Float[np.ndarray, "12 12"]]


def duplicates(
    objects: Sequence[MappedCandidate],
    config: AssociationConfig | None = None,
    joint: JointPoses | None = None,
) -> tuple[Merge, ...]:
    """Pairs of mapped objects that are the same, each with the one to keep.

    Two objects of one category are one where (1) their boxes share more room than two solid things can, `merge_iou`,
    and (2) of 200 points on each one's surface a share of `merge_overlap` lies within `distance` of the other's, as they
    stand; or with the centres brought together, if these differ by no more than their covariances allow: chi-squared
    with 3 degrees of freedom at `probability`, `unmodelled` for each added (headings are left out: a table started
    twice may be turned by half). `joint(a, b)` gives the joint covariance of the two poses; without it they are taken as
    independent, which where they share a camera's error widens that gate. The one to keep has the smaller covariance of pose and scale (its determinant). An object
    merges with one other alone, and one that is kept is never dropped.

    Raises:
        FactorError: a covariance or a code has another shape than its decoder asks for.
    """
    config = config or AssociationConfig()
    near = _near(objects)
    covariances = {}
    for i in sorted({i for pair in near for i in pair}):
        try:
            covariances[i] = objects[i].checked_covariance()
        except SolveError as error:
            _LOG.warning("%s is not compared with its neighbours: %s", objects[i].name, error)
    squared = {
        (a, b): _squared_distance(a, b, objects, covariances, joint, config)
        for a, b in near
        if a in covariances and b in covariances
    }
    accepted = _overlapping(objects, squared, config)
    merges = _stars(objects, covariances, squared, accepted)
    for merge in merges:
        _LOG.info("%s", merge.reason)
    return merges


def _near(objects: Sequence[MappedCandidate]) -> list[tuple[int, int]]:
    """Pairs of one category of which the larger's bounding sphere holds the other's centre."""
    usable = [i for i, entry in enumerate(objects) if entry.is_finite]
    if len(usable) < 2:
        return []
    centres = np.array([objects[i].state.T_world_object.translation() for i in usable])
    radii = np.array([objects[i].radius for i in usable])
    kinds = np.array([category_of(objects[i].category) for i in usable])
    a, b = cKDTree(centres).query_pairs(radii.max(), output_type="ndarray").T
    apart = np.linalg.norm(centres[a] - centres[b], axis=1)
    kept = (kinds[a] == kinds[b]) & (apart <= np.maximum(radii[a], radii[b]))
    return sorted((usable[min(i, j)], usable[max(i, j)]) for i, j in zip(a[kept], b[kept], strict=True))


def _squared_distance(
    a: int,
    b: int,
    objects: Sequence[MappedCandidate],
    covariances: dict[int, Float[np.ndarray, "d d"]],
    joint: JointPoses | None,
    config: AssociationConfig,
) -> float:
    """Squared Mahalanobis distance of the centres; infinite where they differ along what both covariances hold."""
    poses = [objects[i].state.T_world_object for i in (a, b)]
    if joint is None:
        both = np.zeros((2 * POSE_DOF, 2 * POSE_DOF))
        both[:POSE_DOF, :POSE_DOF] = covariances[a][:POSE_DOF, :POSE_DOF]
        both[POSE_DOF:, POSE_DOF:] = covariances[b][:POSE_DOF, :POSE_DOF]
    else:
        both = np.asarray(joint(a, b), dtype=float)
        if both.shape != (2 * POSE_DOF, 2 * POSE_DOF):
            raise FactorError(
                f"{objects[a].name} and {objects[b].name}: a joint covariance of two poses is 12x12, not {both.shape}"
            )
    J = np.zeros((3, 2 * POSE_DOF))
    J[:, 3:6] = poses[0].rotation().matrix()
    J[:, 9:12] = -poses[1].rotation().matrix()
    covariance = J @ both @ J.T + 2 * config.unmodelled**2 * np.eye(3)
    values, axes = np.linalg.eigh(covariance)
    along = axes.T @ (poses[0].translation() - poses[1].translation())
    held = values <= _ROUNDING * (np.trace(both[3:6, 3:6]) + np.trace(both[9:12, 9:12]))
    if (np.abs(along[held]) > _SAME_PLACE).any():
        return np.inf
    return float((along[~held] ** 2 / values[~held]).sum())


def _overlapping(
    objects: Sequence[MappedCandidate], squared: Mapping[tuple[int, int], float], config: AssociationConfig
) -> dict[tuple[int, int], tuple[float, float]]:
    """Of the pairs those that stand in one place and have one surface, with the boxes' IoU and the overlap."""
    involved = sorted({i for pair in squared for i in pair})
    surfaces = dict(
        zip(involved, _surfaces([objects[i] for i in involved], config.merge_points), strict=True)
    )
    boxes = {i: _box(objects[i], surfaces[i]) for i in involved if len(surfaces[i])}
    iou = {(a, b): box_iou(boxes[a], boxes[b]) for a, b in squared if a in boxes and b in boxes}
    iou = {pair: value for pair, value in iou.items() if value >= config.merge_iou}
    limit = squared_limit(config.probability, 3)
    gated = {pair for pair, value in squared.items() if value <= limit}
    overlap = _overlaps(objects, list(iou), gated, surfaces, config)
    return {pair: (iou[pair], share) for pair, share in overlap.items() if share >= config.merge_overlap}


def _surfaces(objects: Sequence[MappedCandidate], count: int) -> list[Float[np.ndarray, "n 3"]]:
    """At most `count` canonical points on each object's surface."""
    start = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3))
    codes = [torch.as_tensor(np.array(entry.state.code)).to(entry.decoder.like) for entry in objects]
    points = [torch.as_tensor(start).to(entry.decoder.like) for entry in objects]
    for _ in range(_PROJECTIONS):
        jets = decode([Asked(o.decoder, c, p) for o, c, p in zip(objects, codes, points, strict=True)])
        points = [_projected(p, jet.value, jet.d_point) for p, jet in zip(points, jets, strict=True)]
    jets = decode([Asked(o.decoder, c, p) for o, c, p in zip(objects, codes, points, strict=True)])
    found = []
    for p, jet in zip(points, jets, strict=True):
        arrived = (jet.value.abs() < _ON_SURFACE) & (p.abs() < BOX_HALF_SIZE).all(dim=1)
        found.append(p[arrived].double().cpu().numpy())
    return found


def _projected(points: torch.Tensor, value: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    return points - (value / gradient.square().sum(dim=1).clamp_min(0.25))[:, None] * gradient


def _box(entry: MappedCandidate, surface: Float[np.ndarray, "n 3"]) -> OrientedBox:
    low, high = surface.min(axis=0), surface.max(axis=0)
    centre = entry.state.to_world(0.5 * (low + high)[None])[0]
    extents = np.maximum((high - low) * entry.state.scale, 1e-3)
    return OrientedBox(centre, entry.state.T_world_object.rotation().matrix(), extents)


def _overlaps(
    objects: Sequence[MappedCandidate],
    pairs: Sequence[tuple[int, int]],
    gated: Collection[tuple[int, int]],
    surfaces: dict[int, Float[np.ndarray, "n 3"]],
    config: AssociationConfig,
) -> dict[tuple[int, int], float]:
    """The lesser of both ways' overlaps, as the two stand or, of those that are gated, with their centres together."""
    queries, of = [], []
    for a, b in pairs:
        between = (
            objects[b].state.T_world_object.translation() - objects[a].state.T_world_object.translation()
        ) * ((a, b) in gated)
        for shift in (np.zeros(3), between):
            for source, target, way in ((a, b, shift), (b, a, -shift)):
                p_world = objects[source].state.to_world(surfaces[source]) + way
                goal = objects[target]
                queries.append(query_points(goal.decoder, goal.state, gtsam.Pose3(), p_world))
                of.append(goal)
    jets = decode([Asked(goal.decoder, q.code, q.p_object) for goal, q in zip(of, queries, strict=True)])
    shares = [
        float(
            ((metres_per_unit(jet.d_point, goal.state) * jet.value).abs() <= config.distance).double().mean()
        )
        for goal, jet in zip(of, jets, strict=True)
    ]
    ways = np.array(shares).reshape(-1, 2, 2).min(axis=2).max(axis=1)
    return {pair: float(share) for pair, share in zip(pairs, ways, strict=True)}


def _stars(
    objects: Sequence[MappedCandidate],
    covariances: dict[int, Float[np.ndarray, "d d"]],
    squared: dict[tuple[int, int], float],
    accepted: dict[tuple[int, int], tuple[float, float]],
) -> tuple[Merge, ...]:
    """Each object that is kept with those that are it, the best determined first."""
    size = {i: _log_determinant(covariances[i]) for pair in accepted for i in pair}
    gone: set[int] = set()
    merges = []
    for keep in sorted(size, key=lambda i: (size[i], objects[i].name, i)):
        if keep in gone:
            continue
        gone.add(keep)
        for pair in accepted:
            if keep in pair and (drop := pair[pair[0] == keep]) not in gone:
                gone.add(drop)
                iou, overlap = accepted[pair]
                reason = (
                    f"{objects[drop].name} is {objects[keep].name}, which is better determined: d2 "
                    f"{squared[pair]:.1f} in 3 directions, boxes share {iou:.2f}, surfaces {overlap:.2f}"
                )
                merges.append(Merge(keep, drop, reason, float(np.sqrt(squared[pair])), overlap))
    return tuple(merges)


def _log_determinant(covariance: Float[np.ndarray, "d d"]) -> float:
    sign, value = np.linalg.slogdet(covariance[:RIGID_DOF, :RIGID_DOF])
    return np.inf if sign < 0 else float(value)
