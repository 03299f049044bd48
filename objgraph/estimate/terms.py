"""The SDF and its derivatives at sampled surface points and along sampled rays, for many objects in few calls."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from factors import checks
from factors.base import SLOPES
from factors.batch import CHUNK
from factors.rays import RayCells, passing_depth
from factors.rendering import CLEAR, RayTargets
from factors.sdf import SdfQuery, metres_per_unit, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import ObjectState
from objgraph.errors import ConfigError
from objgraph.estimate.pool import Pool, WorldRays


@dataclass(frozen=True)
class RaySteps:
    """How rays are sampled."""

    samples: int = 50
    """Equal steps through the object's box."""
    band: float = 0.05
    """Metres from the surface within which a sample is differentiated (the paper's small offset delta); at the first
    variances sigma_s is about 1 cm, and 5 sigma leave less than 1 % of the gradient out."""
    slope: float = 400.0
    """Of the occupancy's sigmoid, 1/metres (paper eq:sloped_sigmoid)."""
    tight_box: bool = False
    """Whether rays are cut within the box that the prior's shapes fill, and not within a cube that holds any shape."""
    canonical_band: bool = False
    """Whether `band` is in canonical units and not in metres."""
    band_samples: int | None = None
    """Samples that a ray is rendered from: evenly over the band about where it first crosses the surface, or comes
    nearest to it; the equal steps then only find that place. None renders from the equal steps."""
    first_view_depths: bool = False
    """Whether rays of all views step from where the first of the first view's enters the box to where the last of them
    leaves it, whatever the depth of the object in the other views; only for rays drawn of it, where any is."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, samples=checks.Range(2, 1000), band=checks.POSITIVE, slope=SLOPES,
            band_samples=checks.Range(2, 1000),
        )  # fmt: skip


@dataclass(frozen=True)
class DrawnRays:
    """Rays that meet one object's box, or are to end on it, their samples, and which of these are near its surface.

    Held for a few iterations: the far samples' SDF is not asked for again meanwhile.
    """

    count: int
    """Of all rays drawn, free ones that miss the box included."""
    cells: RayCells
    targets: RayTargets
    p_near: Float[np.ndarray, "c 3"]
    """World points of the near samples."""
    near: Bool[Tensor, "r k"]
    sdf: Float[Tensor, "r k"]
    """Metres, when the rays were drawn."""


@dataclass(frozen=True)
class Linearized:
    """Metric SDF and its derivative w.r.t. [rotation, translation, log-scale, code] at some points."""

    sdf: Float[Tensor, "n"]
    jacobian: Float[Tensor, "n d"]


def draw_rays(
    decoder: SdfDecoder, states: Sequence[ObjectState], pools: Sequence[Pool], steps: RaySteps
) -> list[DrawnRays]:
    """Step through every object's box along its rays, and find the samples that a gradient can come from."""
    walks = [_walk(state, pool, steps) for state, pool in zip(states, pools, strict=True)]
    sdf = _metric_values(decoder, states, walks)
    if steps.band_samples is not None:
        walks = [
            _about_the_surface(walk, state, values.cpu().double().numpy(), steps, steps.band_samples)
            for walk, state, values in zip(walks, states, sdf, strict=True)
        ]
        sdf = _metric_values(decoder, states, walks)
    device, dtype = decoder.like.device, decoder.like.dtype
    result = []
    for walk, metres, state, pool in zip(walks, sdf, states, pools, strict=True):
        unit = float(np.exp(state.log_scale.mean())) if steps.canonical_band else 1.0
        near = _near(metres, steps.slope, steps.band * unit)
        cells = RayCells(
            *(
                torch.as_tensor(array, dtype=dtype, device=device)
                for array in (walk.depth, np.repeat(walk.width[:, None], walk.depth.shape[1], 1), walk.far)
            )
        )
        rays = walk.rays
        targets = RayTargets(
            *(
                torch.as_tensor(array, device=device).to(torch.bool if array.dtype == bool else dtype)
                for array in (rays.depth, rays.hit, rays.end, rays.sigma)
            )
        )
        p_near = rays.at(walk.depth)[near.cpu().numpy()]
        result.append(DrawnRays(len(pool.rays.depth), cells, targets, p_near, near, metres))
    return result


@dataclass(frozen=True)
class _Walk:
    """Sample depths along the rays that say something of one object."""

    rays: WorldRays
    depth: Float[np.ndarray, "r k"]
    width: Float[np.ndarray, "r"]
    """Between samples, along z."""
    far: Float[np.ndarray, "r"]
    """Where the ray leaves the box."""
    meets: Bool[np.ndarray, "r"]
    """Whether it meets the box before it ends."""


def _walk(state: ObjectState, pool: Pool, steps: RaySteps) -> _Walk:
    """Equal steps through the object's box."""
    near, far = pool.rays.interval(state, pool.half_box)
    crosses = far - near > 1e-3
    meets = crosses & (pool.rays.end > near)
    if steps.first_view_depths and (first := crosses & pool.rays.first_view).any():
        near, far = np.full_like(near, near[first].min()), np.full_like(far, far[first].max())
    passes = passing_depth(state, pool.rays.depth, pool.rays.depth_of_centre(state), pool.half_box)
    near, far = np.where(meets, near, passes), np.where(meets, far, passes)
    count = np.flatnonzero(meets | pool.rays.hit)
    rays, near, far, meets = pool.rays.take(count), near[count], far[count], meets[count]
    width = (far - near) / steps.samples
    depth = near[:, None] + (np.arange(steps.samples) + 0.5) * width[:, None]
    return _Walk(rays, depth, width, far, meets)


def _about_the_surface(
    walk: _Walk, state: ObjectState, sdf: Float[np.ndarray, "r k"], steps: RaySteps, samples: int
) -> _Walk:
    """So many samples over the band about each ray's first crossing of the surface, or where it comes nearest to it."""
    inside, each = sdf < 0, np.arange(len(sdf))
    after = np.where(inside.any(axis=1), inside.argmax(axis=1), sdf.argmin(axis=1))
    before = np.maximum(after - inside[each, after], 0)
    fall = sdf[each, before] - sdf[each, after]
    part = np.divide(sdf[each, before], fall, out=np.zeros(len(sdf)), where=fall > 0)
    middle = walk.depth[each, before] + part * (walk.depth[each, after] - walk.depth[each, before])
    direction = walk.rays.direction_world
    if steps.canonical_band:
        direction = direction @ state.T_world_object.rotation().matrix() / state.scale
    half = np.where(walk.meets, steps.band / np.linalg.norm(direction, axis=1), 0.0)
    across = (2 * np.arange(samples) + 1) / samples - 1
    return replace(walk, depth=middle[:, None] + half[:, None] * across, width=2 * half / samples)


def linearize(
    decoder: SdfDecoder, states: Sequence[ObjectState], p_world: Sequence[Float[np.ndarray, "n 3"]]
) -> list[Linearized]:
    """The metric SDF of each object at its own points, all decoded together.

    Metres a canonical unit are those at each point, and held; in the graph's factors they follow the scale (`factors.sdf.MetricSdf`).
    """
    queries = [_query(decoder, state, points) for state, points in zip(states, p_world, strict=True)]
    parts: list[list[Tensor]] = [[], [], []]
    for points, codes, owner in _chunks(queries):
        for part, array in zip(parts, decoder.linearize(points, codes, owner), strict=True):
            part.append(array)
    sizes = [len(query.p_object) for query in queries]
    jets = zip(*(torch.cat(part).split(sizes) for part in parts), strict=True)
    result = []
    for query, state, arrays in zip(queries, states, jets, strict=True):
        jet = SdfJet(*arrays)
        metres = metres_per_unit(jet.d_point, state)
        jacobian = metres[:, None] * sdf_jacobian(query, jet, camera=False)
        result.append(Linearized(metres * jet.value, jacobian))
    return result


def _near(sdf: Float[Tensor, "r k"], slope: float, band: float) -> Bool[Tensor, "r k"]:
    """Samples within the band that a ray can reach, be the surface half the band farther off."""
    passed = torch.cumprod(torch.sigmoid(slope * (sdf + 0.5 * band)), dim=1)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    return (sdf.abs() < band) & (before > 1e-4)


def _metric_values(
    decoder: SdfDecoder, states: Sequence[ObjectState], walks: Sequence[_Walk]
) -> list[Float[Tensor, "r k"]]:
    """SDF at all samples, metres; clear where a ray does not meet the box."""
    inside = [walk.rays.take(walk.meets).at(walk.depth[walk.meets]).reshape(-1, 3) for walk in walks]
    result = []
    for walk, value, state in zip(walks, _values(decoder, states, inside), states, strict=True):
        metres = value.new_full(walk.depth.shape, CLEAR)
        unit = float(np.exp(state.log_scale.mean()))
        metres[torch.as_tensor(walk.meets, device=value.device)] = unit * value.view(-1, walk.depth.shape[1])
        result.append(metres)
    return result


def _values(
    decoder: SdfDecoder, states: Sequence[ObjectState], p_world: Sequence[Float[np.ndarray, "n 3"]]
) -> list[Float[Tensor, "n"]]:
    """Canonical SDF of each object at its own points."""
    queries = [_query(decoder, state, points) for state, points in zip(states, p_world, strict=True)]
    with torch.no_grad():
        values = [decoder(points, codes, owner) for points, codes, owner in _chunks(queries)]
    return list(torch.cat(values).split([len(query.p_object) for query in queries]))


def _query(decoder: SdfDecoder, state: ObjectState, p_world: Float[np.ndarray, "n 3"]) -> SdfQuery:
    return query_points(decoder, state, gtsam.Pose3(), p_world)


def _chunks(
    queries: Sequence[SdfQuery],
) -> list[tuple[Float[Tensor, "n 3"], Float[Tensor, "b l"], Int[Tensor, "n"]]]:
    """All queries' points with their owners, cut into calls of bounded size."""
    points = torch.cat([query.p_object for query in queries])
    codes = torch.stack([query.code for query in queries])
    sizes = torch.tensor([len(query.p_object) for query in queries])
    owner = torch.repeat_interleave(torch.arange(len(queries)), sizes).to(points.device)
    return [
        (points[i : i + CHUNK], codes, owner[i : i + CHUNK]) for i in range(0, max(len(points), 1), CHUNK)
    ]
