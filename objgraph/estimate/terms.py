"""The SDF and its derivatives at sampled surface points and along sampled rays, for many objects in few calls."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from factors.batch import CHUNK
from factors.rays import RayCells, passing_depth
from factors.rendering import CLEAR, RayTargets
from factors.sdf import SdfQuery, metres_per_unit, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import ObjectState
from objgraph.estimate.pool import Pool


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
    device, dtype = decoder.like.device, decoder.like.dtype
    drawn = []
    for state, pool in zip(states, pools, strict=True):
        near, far = pool.rays.interval(state, pool.half_box)
        meets = (far - near > 1e-3) & (pool.rays.end > near)
        passes = passing_depth(state, pool.rays.depth, pool.rays.depth_of_centre(state), pool.half_box)
        near, far = np.where(meets, near, passes), np.where(meets, far, passes)
        count = np.flatnonzero(meets | pool.rays.hit)
        rays, near, far, meets = pool.rays.take(count), near[count], far[count], meets[count]
        width = (far - near) / steps.samples
        depth = near[:, None] + (np.arange(steps.samples) + 0.5) * width[:, None]
        drawn.append((rays, depth, width, far, meets))
    inside = [rays.take(meets).at(depth[meets]).reshape(-1, 3) for rays, depth, _, _, meets in drawn]
    sdf = _values(decoder, states, inside)
    result = []
    for (rays, depth, width, far, meets), value, state, pool in zip(drawn, sdf, states, pools, strict=True):
        metres = torch.full(depth.shape, CLEAR, dtype=dtype, device=device)
        metres[torch.as_tensor(meets, device=device)] = float(np.exp(state.log_scale.mean())) * value.view(
            -1, steps.samples
        )
        near = _near(metres, steps)
        cells = RayCells(
            *(
                torch.as_tensor(array, dtype=dtype, device=device)
                for array in (depth, np.repeat(width[:, None], steps.samples, 1), far)
            )
        )
        targets = RayTargets(
            *(
                torch.as_tensor(array, device=device).to(torch.bool if array.dtype == bool else dtype)
                for array in (rays.depth, rays.hit, rays.end, rays.sigma)
            )
        )
        p_near = rays.at(depth)[near.cpu().numpy()]
        result.append(DrawnRays(len(pool.rays.depth), cells, targets, p_near, near, metres))
    return result


def linearize(
    decoder: SdfDecoder, states: Sequence[ObjectState], p_world: Sequence[Float[np.ndarray, "n 3"]]
) -> list[Linearized]:
    """The metric SDF of each object at its own points, all decoded together.

    Metres a canonical unit are those at each point and held, as in the graph's factors.
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


def _near(sdf: Float[Tensor, "r k"], steps: RaySteps) -> Bool[Tensor, "r k"]:
    """Samples within the band that a ray can reach, be the surface half the band farther off."""
    passed = torch.cumprod(torch.sigmoid(steps.slope * (sdf + 0.5 * steps.band)), dim=1)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    return (sdf.abs() < steps.band) & (before > 1e-4)


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
