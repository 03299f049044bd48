"""Camera rays through an object's box, and the cells along them at which the object is decoded."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from factors import checks
from factors.checks import DEVIATIONS, PLACES
from factors.errors import FactorError
from factors.state import ObjectState

BOX_HALF_SIZE = 0.55
"""Half the edge of the canonical cube that holds every shape (diagonal 1, so no half extent exceeds 0.5)."""


@dataclass(frozen=True)
class Rays:
    """What the pixels of one view say about where rays end; directions have z = 1, so lengths are z-depths."""

    directions_camera: Float[np.ndarray, "r 3"]
    depth: Float[np.ndarray, "r"]
    """z-depth of the object's surface in metres: where a hit ends, and where the object's outline next to a ray
    that passes it is."""
    hit: Bool[np.ndarray, "r"]
    """True where the ray ends on the object, False where it passes it."""
    end: Float[np.ndarray, "r"]
    """z-depth up to which the ray is, or without the object would be, seen: where the background or an occluder
    begins. It says nothing about the object beyond. Of a hit it is not known, and made infinite, where it is no more than the
    hit's depth: a hit is seen that far at least."""
    sigma: Float[np.ndarray, "r"]
    """Standard deviation of what the ray says of the surface's place, metres."""
    origins_camera: Float[np.ndarray, "r 3"] | None = None
    """Where each ray begins, of rays of several cameras, whose directions are as long as those of z = 1 in their own; None of
    one camera's rays, which begin at its centre."""

    def __post_init__(self) -> None:
        directions = checks.reals(
            "`directions_camera` of the rays", self.directions_camera, (None, 3), PLACES
        )
        n = len(directions)
        if n == 0:
            raise FactorError("rays of shape (0, 3): at least one is due")
        if self.origins_camera is not None:
            origins = checks.reals("`origins_camera` of the rays", self.origins_camera, (n, 3), PLACES)
            object.__setattr__(self, "origins_camera", origins)
        elif not np.allclose(directions[:, 2], 1.0):
            raise FactorError("ray directions must have z = 1, so that lengths along them are z-depths")
        found = {
            "directions_camera": directions,
            "depth": checks.reals("`depth` of the rays", self.depth, (n,), DEVIATIONS),
            "hit": checks.array("`hit` of the rays", self.hit, (n,), kinds="b"),
            "end": checks.array("`end` of the rays", self.end, (n,), finite=False).astype(float),
            "sigma": checks.reals("`sigma` of the rays", self.sigma, (n,), DEVIATIONS),
        }
        if np.isnan(found["end"]).any():
            raise FactorError("`end` of the rays must not be NaN: drop pixels without depth first")
        found["end"][found["hit"] & (found["end"] <= found["depth"])] = np.inf
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def take(self, indices: np.ndarray) -> "Rays":
        """Some of the rays."""
        origins = None if self.origins_camera is None else self.origins_camera[indices]
        return Rays(
            self.directions_camera[indices], self.depth[indices], self.hit[indices], self.end[indices],
            self.sigma[indices], origins,
        )  # fmt: skip

    def depth_beside(self, p_camera: Float[np.ndarray, "3"]) -> Float[np.ndarray, "r"]:
        """Depth at which each ray is nearest to a point."""
        directions = self.directions_camera
        away = p_camera if self.origins_camera is None else p_camera - self.origins_camera
        return (directions * away).sum(axis=1) / np.square(directions).sum(axis=1)

    def in_world(self, T_world_camera: gtsam.Pose3) -> "Rays":
        """The same where the camera frame is the world's."""
        R, t = T_world_camera.rotation().matrix(), T_world_camera.translation()
        origins = np.zeros((1, 3)) if self.origins_camera is None else self.origins_camera
        origins = np.broadcast_to(origins @ R.T + t, self.directions_camera.shape)
        return replace(self, directions_camera=self.directions_camera @ R.T, origins_camera=origins)

    @staticmethod
    def together(several: "Sequence[Rays]") -> "Rays":
        """Rays of one frame, each with its origin."""
        return Rays(*map(np.concatenate, zip(*(vars(rays).values() for rays in several), strict=True)))


@dataclass(frozen=True)
class RayCells:
    """A partition of each ray's way through the object's box; frozen while a quadratic is minimised."""

    depth: Float[Tensor, "r k"]
    """z-depth of each cell's sample, its middle."""
    width: Float[Tensor, "r k"]
    """Length of each cell along z, metres."""
    far: Float[Tensor, "r"]
    """Where the ray leaves the box."""


def box_interval(
    state: ObjectState,
    T_world_camera: gtsam.Pose3,
    directions_camera: Float[np.ndarray, "r 3"],
    half: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE,
    origins_camera: Float[np.ndarray, "r 3"] | None = None,
) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"]]:
    """z-depths at which rays enter and leave the object's canonical box of `half` its edges; near >= far where they miss it.

    Rays begin at the camera's centre, unless they have `origins_camera`."""
    begin = np.zeros((1, 3)) if origins_camera is None else origins_camera
    R_world_camera = T_world_camera.rotation().matrix()
    origin = state.to_object(begin @ R_world_camera.T + T_world_camera.translation())
    R_object_camera = state.T_world_object.rotation().matrix().T @ R_world_camera
    return canonical_interval(origin, directions_camera @ R_object_camera.T / state.scale, half)


def passing_depth(
    state: ObjectState,
    depth: Float[np.ndarray, "r"],
    centre_depth: float | Float[np.ndarray, "r"],
    half: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE,
) -> Float[np.ndarray, "r"]:
    """z-depths at which hits at `depth` that miss the object's box are said to leave it: no less than through the box.

    So a hit costs no less where the object is out of its way than where the object lets it pass. `centre_depth` is that
    of the object's origin: along the camera's z axis, or where each ray comes nearest to it.
    """
    radius = float(np.linalg.norm(np.broadcast_to(half, 3) * state.scale))
    return np.maximum(depth + 2 * radius, centre_depth + radius)


def canonical_interval(
    origin: Float[np.ndarray, "*r 3"],
    direction: Float[np.ndarray, "r 3"],
    half: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE,
) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"]]:
    """Multiples of `direction`, in canonical coordinates, at which rays enter and leave the canonical box."""
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    half = np.broadcast_to(half, 3)
    bounds = (np.stack([-half, half])[:, None, :] - origin) / direction
    near = bounds.min(axis=0).max(axis=-1)
    far = bounds.max(axis=0).min(axis=-1)
    return np.maximum(near, 1e-3), far


def coarse_depths(near: Float[Tensor, "r"], far: Float[Tensor, "r"], count: int) -> Float[Tensor, "r c"]:
    """Middles of `count` equal cells between near and far."""
    fraction = (torch.arange(count, dtype=near.dtype) + 0.5) / count
    return near[:, None] + fraction * (far - near)[:, None]


def empty_cells(far: Float[Tensor, "r"], count: int = 1) -> RayCells:
    """Cells without length, of rays that are outside of the box all the way; they leave it at `far`."""
    depth = far[:, None].expand(-1, count)
    return RayCells(depth, torch.zeros_like(depth), far)


def choose_cells(
    near: Float[Tensor, "r"],
    far: Float[Tensor, "r"],
    coarse_sdf: Float[Tensor, "r c"],
    depth: Float[Tensor, "r"],
    step_at: Float[Tensor, "r"],
    count: int,
    band: Float[Tensor, "r"],
) -> RayCells:
    """`count` cells a ray, fine where the coarse SDF (metres) is within `band` of zero and about `depth`.

    Edges are quantiles of a density over the ray, and the edge nearest to `step_at` is moved onto it, so that no
    cell straddles the depth at which the observation changes.
    """
    coarse = coarse_sdf.shape[1]
    step = (far - near) / coarse
    middle = coarse_depths(near, far, coarse)
    density = torch.exp(-0.5 * (coarse_sdf / band[:, None]) ** 2)
    density = density + 0.5 * torch.exp(-0.5 * ((middle - depth[:, None]) / band[:, None]) ** 2) + 0.05
    cumulative = torch.cat([torch.zeros_like(near)[:, None], density.cumsum(dim=1)], dim=1)
    cumulative = cumulative / cumulative[:, -1:]
    quantile = torch.linspace(0, 1, count + 1, dtype=near.dtype).expand(len(near), -1).contiguous()
    right = torch.searchsorted(cumulative, quantile).clamp(1, coarse)
    left_mass, right_mass = cumulative.gather(1, right - 1), cumulative.gather(1, right)
    edges = near[:, None] + step[:, None] * (right - 1 + (quantile - left_mass) / (right_mass - left_mass))
    return _cells(_snap(edges, step_at), far)


def _snap(edges: Float[Tensor, "r k+1"], observed: Float[Tensor, "r"]) -> Float[Tensor, "r k+1"]:
    inner = edges[:, 1:-1]
    nearest = (inner - observed[:, None]).abs().argmin(dim=1, keepdim=True)
    inside = (observed > edges[:, 0]) & (observed < edges[:, -1])
    moved = torch.where(inside, observed, inner.gather(1, nearest)[:, 0])
    inner = inner.scatter(1, nearest, moved[:, None])
    return torch.cat([edges[:, :1], inner, edges[:, -1:]], dim=1)


def _cells(edges: Float[Tensor, "r k+1"], far: Float[Tensor, "r"]) -> RayCells:
    return RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), far)
