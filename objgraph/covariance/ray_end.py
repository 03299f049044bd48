"""Where a ray ends on an uncertain object, from the uncertain SDF along it.

An object that moves along a ray moves where the ray ends by as much, however far; all else enters the SDF to first order.
So what goes along with that move is integrated over, the SDF moving with it, and decoded where the object is estimated to be.
"""

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors.occupancy import PROBIT_SCALE, probit_occupancy
from factors.rays import BOX_HALF_SIZE, RayCells, box_interval, choose_cells, coarse_depths
from factors.sdf import propagated_variance, query_points
from factors.sdf_decoder import SdfDecoder
from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.surface import metric_sdf_jacobian
from objgraph.geometry.frames import transformed

_SLOPE = 400.0
"""Of the occupancy's sigmoid, 1/metres (paper eq:sloped_sigmoid)."""
_NEAREST = 1e-3
"""Depth at which rays begin, metres."""
_REACH = 3.0
"""Standard deviations by which a surface may leave the estimate's box and still be looked for."""
_STEP = 0.5
"""Between moves along the ray, in their standard deviations."""
_MOVES = torch.arange(-4.0, 4.0 + _STEP, _STEP, dtype=torch.float64)
_WITHIN = _STEP**2 / 12
"""Variance of a move that is spread evenly over a step."""
_GRAZING = 0.1
"""Slope of the SDF along a ray under which its surface, moved across itself, does not move along the ray by as much."""
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * BOX_HALF_SIZE


def ray_ends(
    decoder: SdfDecoder,
    state: ObjectState,
    covariance: ObjectCovariance,
    T_world_camera: gtsam.Pose3,
    directions_camera: Float[np.ndarray, "r 3"],
    residual_sigma: float,
    samples: int,
) -> tuple[Float[np.ndarray, "r k"], Float[np.ndarray, "r k"]]:
    """Rising z-depths, metres, and the probability that each ray has ended at or before them.

    Both zero for rays that miss the object however it may stand. Raises SolveError where the decoder's answer is not finite.
    """
    depth, reached = np.zeros((2, len(directions_camera), samples))
    R_object_camera = state.T_world_object.rotation().matrix().T @ T_world_camera.rotation().matrix()
    beyond = _beyond(state, covariance, directions_camera @ R_object_camera.T)  # metres
    half = BOX_HALF_SIZE + _REACH * beyond / state.scale
    near, far = box_interval(state, T_world_camera, directions_camera, half)
    meets = np.flatnonzero(far - near > _NEAREST)
    if not len(meets):
        return depth, reached
    directions = directions_camera[meets]

    def places(depths: Float[Tensor, "r k"]) -> Float[np.ndarray, "rk 3"]:
        p_camera = directions[:, None, :] * depths.numpy()[:, :, None]
        return transformed(T_world_camera.matrix(), p_camera.reshape(-1, 3))

    start, end = torch.as_tensor(near[meets]), torch.as_tensor(far[meets])
    coarse = coarse_depths(start, end, samples)
    blur = float(np.linalg.norm([beyond.max(), residual_sigma * state.scale.max(), PROBIT_SCALE / _SLOPE]))
    cells = _cells(start, end, _coarse_sdf(decoder, state, places(coarse)).view_as(coarse), blur)
    moved = _moved(
        decoder, state, covariance, places(cells.depth), directions @ R_object_camera.T, residual_sigma
    )
    knots, ended = _ended(start, cells.depth, moved)
    depth[meets], reached[meets] = knots.numpy(), ended.numpy()
    return depth, reached


def mixed_ends(
    shares: Sequence[float], parts: Sequence[tuple[Float[np.ndarray, "r k"], Float[np.ndarray, "r k"]]]
) -> tuple[Float[np.ndarray, "r k"], Float[np.ndarray, "r k"]]:
    """The same of an object that is one of several, of which `parts` are what `ray_ends` found."""
    depth = np.zeros_like(parts[0][0])
    reached = np.zeros_like(depth)
    for i in range(len(depth)):
        meets = [(share, d[i], p[i]) for share, (d, p) in zip(shares, parts, strict=True) if p[i, -1] > 0]
        if not meets:
            continue
        at = np.sort(np.concatenate([d for _, d, _ in meets]))
        ended = np.sum([share * np.interp(at, d, p, left=0.0) for share, d, p in meets], axis=0)
        depth[i] = np.interp(ended[-1] * _levels(depth.shape[1], torch.float64).numpy(), ended, at)
        reached[i] = np.interp(depth[i], at, ended)
        reached[i, -1] = ended[-1]
    return depth, reached


class _Moved(NamedTuple):
    """The SDF along r rays under moves of the object along them, which are counted in their standard deviations."""

    sdf: Float[Tensor, "r k"]
    """Metres, where the object is estimated to be."""
    change: Float[Tensor, "r k"]
    """Of the SDF at the same place of the object, which moves along, with a move and what goes along with it."""
    variance: Float[Tensor, "r k"]
    """Square metres: of all that does not go along with a move, the occupancy's own softness counted."""
    shift: Float[Tensor, "r"]
    """Metres along z by which the surface moves with a move."""


def _moved(
    decoder: SdfDecoder,
    state: ObjectState,
    covariance: ObjectCovariance,
    p_world: Float[np.ndarray, "rk 3"],
    directions_object: Float[np.ndarray, "r 3"],
    residual_sigma: float,
) -> _Moved:
    """At k places of each ray, whose directions are metres along the object's axes for a z-depth of 1."""
    sdf, jacobian, metres = _extended_sdf(decoder, state, p_world)
    r, matrix = len(directions_object), torch.as_tensor(np.array(covariance.matrix))
    soft = (PROBIT_SCALE / _SLOPE) ** 2
    variance = (propagated_variance(jacobian, matrix) + (residual_sigma * metres) ** 2 + soft).view(r, -1)
    d_move = torch.as_tensor(directions_object)
    along = torch.zeros(r, len(matrix), dtype=torch.float64)
    along[:, 3:6] = d_move / d_move.square().sum(dim=1, keepdim=True)
    move = propagated_variance(along, matrix).clamp_min(0).sqrt()
    sdf, rows = sdf.view(r, -1), jacobian.view(*variance.shape, -1)
    change = torch.einsum("rkd,rd->rk", rows, along @ matrix / move.clamp_min(1e-12)[:, None])
    slope = torch.einsum("rkd,rd->rk", rows[:, :, 3:6], d_move)  # with a metre of the move alone
    shift = _shift(sdf, change, slope, move)
    rest = change - slope * shift[:, None]
    variance = (variance - change.square()).clamp_min(soft) + _WITHIN * rest.square()
    return _Moved(sdf, rest, variance, shift)


def _ended(
    start: Float[Tensor, "r"], depth: Float[Tensor, "r k"], moved: _Moved
) -> tuple[Float[Tensor, "r k"], Float[Tensor, "r k"]]:
    """Depths and the probability to have ended there, over all moves; rays begin at `start`."""
    at = torch.cat([start[:, None], depth], dim=1)[:, :, None] + (moved.shift[:, None] * _MOVES)[:, None, :]
    mean = moved.sdf[:, :, None] + moved.change[:, :, None] * _MOVES
    occupied = probit_occupancy(mean, moved.variance.sqrt()[:, :, None])
    occupied = torch.where(at[:, 1:] >= _NEAREST, occupied, 0.0)
    of_move = torch.nn.functional.pad(occupied, (0, 0, 1, 0)).cummax(dim=1)[0]
    weight = torch.softmax(-0.5 * _MOVES.square() / (1 - _WITHIN), dim=0)
    spread = (_STEP * moved.shift.abs()).clamp_min(1e-4)  # a difference quotient is taken over it
    ends = weight * of_move.diff(dim=1, prepend=torch.zeros_like(of_move[:, :1]))
    knots = _knots(at, ends, spread, depth.shape[1])
    return knots, _mixed(at, of_move, weight, spread, knots).cummax(dim=1)[0].clamp(0, 1)


def _shift(
    sdf: Float[Tensor, "r k"],
    change: Float[Tensor, "r k"],
    slope: Float[Tensor, "r k"],
    move: Float[Tensor, "r"],
) -> Float[Tensor, "r"]:
    """By how much the surface moves along each ray with a standard deviation of the object's move: by as much, unless what
    goes along with it, such as the size of an object whose seen side is known, undoes that there.

    A ray that passes the object ends on no surface whose slope would say how far that moves: it is as far as the object."""
    inside = sdf <= 0
    place = inside.int().argmax(dim=1, keepdim=True)
    c, s = change.gather(1, place)[:, 0], slope.gather(1, place)[:, 0]
    shift = (c * s + _GRAZING**2 * move) / (s.square() + _GRAZING**2)
    return torch.where(inside.any(dim=1), shift, move)


def _beyond(
    state: ObjectState, covariance: ObjectCovariance, directions_object: Float[np.ndarray, "r 3"]
) -> Float[np.ndarray, "3"]:
    """Largest standard deviation, metres along the object's axes, of a corner of its box, moves along a ray left out."""
    q = _CORNERS * state.scale
    of_corner = np.zeros((len(q), 3, RIGID_DOF))
    of_corner[:, :, :3] = [-gtsam.SO3.Hat(each) for each in q]
    of_corner[:, range(3), range(6, 9)] = q
    e = directions_object / np.linalg.norm(directions_object, axis=1, keepdims=True)
    across = np.zeros((len(e), 1, 3, RIGID_DOF))
    across[:, 0, :, 3:6] = np.eye(3) - e[:, :, None] * e[:, None, :]
    J = of_corner + across
    variance = ((J @ covariance.rigid) * J).sum(axis=-1)
    return np.sqrt(variance.max(axis=(0, 1)).clip(0))


def _cells(
    near: Float[Tensor, "r"], far: Float[Tensor, "r"], sdf: Float[Tensor, "r c"], blur: float
) -> RayCells:
    """As many cells a ray as it has samples, fine within `blur` metres of the surface; nothing was observed."""
    band = (0.5 * (far - near) / sdf.shape[1]).clamp_min(blur)
    nowhere = torch.full_like(near, -torch.inf)
    return choose_cells(near, far, sdf, nowhere, nowhere, sdf.shape[1], band)


def _coarse_sdf(
    decoder: SdfDecoder, state: ObjectState, p_world: Float[np.ndarray, "n 3"]
) -> Float[Tensor, "n"]:
    """About how far the surface is, metres."""
    p_object = state.to_object(p_world)
    inside = np.clip(p_object, -BOX_HALF_SIZE, BOX_HALF_SIZE)
    query = query_points(decoder, state, gtsam.Pose3(), state.to_world(inside))
    with torch.no_grad():
        sdf = decoder(query.p_object, query.code[None]).cpu().double()
    beyond = torch.as_tensor((p_object - inside) * state.scale).norm(dim=1)
    return float(np.exp(state.log_scale.mean())) * sdf + beyond


def _extended_sdf(
    decoder: SdfDecoder, state: ObjectState, p_world: Float[np.ndarray, "n 3"]
) -> tuple[Float[Tensor, "n"], Float[Tensor, "n d"], Float[Tensor, "n"]]:
    """`metric_sdf_jacobian`, outside of the box, where no decoder was trained, by the tangent plane at the nearest place in it."""
    p_object = state.to_object(p_world)
    inside = np.clip(p_object, -BOX_HALF_SIZE, BOX_HALF_SIZE)
    sdf, jacobian, metres = metric_sdf_jacobian(decoder, state, state.to_world(inside))
    beyond = torch.as_tensor((p_object - inside) * state.scale)
    normal = -jacobian[:, 3:6]
    away = (normal * beyond).sum(dim=1)
    jacobian[:, :3] += torch.linalg.cross(normal, beyond)
    share = torch.nn.functional.normalize(normal, dim=1).square()
    jacobian[:, 6:9] += away[:, None] * share - normal * beyond
    return sdf + away, jacobian, metres


def _knots(
    at: Float[Tensor, "r k m"], ends: Float[Tensor, "r k m"], spread: Float[Tensor, "r"], count: int
) -> Float[Tensor, "r n"]:
    """Depths between which about equally many rays end, fewer towards both tails."""
    golden = (
        0.618034 * torch.arange(at.shape[1], dtype=at.dtype)
    ) % 1 - 0.5  # spread evenly, however few cells there are
    at = at + (spread[:, None] * golden)[:, :, None]
    at, order = at.flatten(1).clamp_min(_NEAREST).sort(dim=1)
    ends = ends.flatten(1).gather(1, order) + 1e-15
    share = ends.cumsum(dim=1) / ends.sum(dim=1, keepdim=True)
    levels = _levels(count, at.dtype)
    return at.gather(1, torch.searchsorted(share, levels.expand(len(at), -1).contiguous()))


def _levels(count: int, dtype: torch.dtype) -> Float[Tensor, "n"]:
    """Shares of the rays that end, dense towards none and all."""
    return (0.5 * torch.pi * torch.linspace(0, 1, count, dtype=dtype)).sin().square().clamp(1e-6, 1 - 1e-6)


def _mixed(
    at: Float[Tensor, "r k m"],
    reached: Float[Tensor, "r k m"],
    weight: Float[Tensor, "m"],
    spread: Float[Tensor, "r"],
    depth: Float[Tensor, "r n"],
) -> Float[Tensor, "r n"]:
    """Weighted sum of what was reached, piecewise linear in depth, under each of m moves, each spread evenly."""
    total, half = torch.zeros_like(depth), 0.5 * spread[:, None]
    for i, share in enumerate(weight):
        x, y = at[:, :, i].contiguous(), reached[:, :, i]
        behind = _integral(x, y, depth + half) - _integral(x, y, depth - half)
        total += share * behind / spread[:, None]
    return total


def _integral(
    x: Float[Tensor, "r k"], y: Float[Tensor, "r k"], to: Float[Tensor, "r n"]
) -> Float[Tensor, "r n"]:
    """Integral of a piecewise linear function that is 0 before, and stays what it is behind."""
    width = x.diff(dim=1)
    area = torch.nn.functional.pad((0.5 * (y[:, 1:] + y[:, :-1]) * width).cumsum(dim=1), (1, 0))
    left = (torch.searchsorted(x, to) - 1).clamp(0, x.shape[1] - 1)
    rise = torch.nn.functional.pad(y.diff(dim=1) / width.clamp_min(1e-12), (0, 1))
    step = (to - x.gather(1, left)).clamp_min(0)
    return area.gather(1, left) + step * (y.gather(1, left) + 0.5 * step * rise.gather(1, left))
