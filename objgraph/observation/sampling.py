"""From a frame and an instance id to what the factors take: surface points and rays in the camera frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float, Int

from factors import checks
from factors.checks import DEVIATIONS, PLACES
from factors.rays import Rays
from objgraph.errors import ConfigError, ObservationError
from objgraph.geometry.frames import transformed, why_not_rigid
from objgraph.geometry.voxels import voxel_keys
from objgraph.observation.frames import IDS, Frame
from objgraph.observation.masks import (
    check_mask,
    clean_depth,
    free_weights,
    nearest,
    not_seen_past,
    of_one_object,
    without_flying,
)

_SOME = checks.Range(1)
_WIDTHS = checks.Range(1e-6, 1e4)


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviation of a depth z: `base + quadratic * z^2`, metres."""

    base: float = 0.003
    """At the camera."""
    quadratic: float = 0.0015
    """1/metres; a structured-light sensor's is about 0.0015 to 0.003."""

    def __post_init__(self) -> None:
        """Raises ConfigError where it is negative, or nothing at the camera."""
        checks.settings(self, ConfigError, base=DEVIATIONS, quadratic=checks.Range(0, 1e3))

    def __call__(self, depth: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        return self.base + self.quadratic * np.square(depth)


@dataclass(frozen=True)
class SamplingConfig:
    """How a view of an object is sampled."""

    points: int = 300
    """Surface points a view."""
    hits: int = 150
    """Rays a view that end on the object."""
    free: int = 150
    """Rays a view that pass beside it."""
    min_pixels: int = 60
    """Mask pixels with depth below which a view says too little to be used."""
    max_depth: float = 20.0
    """Depths beyond this are no measurements of furniture or cars; a median beyond it is taken for an error."""
    margin: float = 0.1
    """Distance from the mask, as a share of its size, at which free rays are half as dense as at its outline."""
    step: float = 0.25
    """A mask pixel this much behind the one beside it (metres) is seen past the object, not on it."""
    gap: float = 1.0
    """Small parts of a mask's points farther than this (metres) from the rest are not of the object."""
    mask_sigma: float = 1.0
    """Pixels by which a mask's outline errs."""
    flying: float = 0.06
    """A pixel whose depth differs by more (metres) from the median of its mask neighbours is between surfaces."""
    correlation_length: float = 0.2
    """Metres: surface closer than this errs together, so each cube of that size is one independent measurement."""
    noise: SensorNoise = SensorNoise()

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, points=_SOME, hits=_SOME, min_pixels=checks.Range(3), max_depth=_WIDTHS,
            margin=_WIDTHS, flying=_WIDTHS, correlation_length=_WIDTHS,
        )  # fmt: skip


@dataclass(frozen=True)
class ObjectView:
    """One view of one object, sampled."""

    frame: str
    T_world_camera: gtsam.Pose3
    points_camera: Float[np.ndarray, "n 3"]
    """Measured surface points, metres."""
    points_sigma: Float[np.ndarray, "n"]
    """The sensor's standard deviation at each."""
    rays: Rays
    correlation_length: float
    """Metres: what of the surface lies within one cube of that size errs together."""

    def __post_init__(self) -> None:
        """Raises ObservationError where something is of another kind or shape; points need not be finite."""
        where = f"frame {checks.text('the frame of a view', self.frame, ObservationError)}"
        checks.pose(f"{where}: T_world_camera", self.T_world_camera, ObservationError)
        points = checks.array(
            f"{where}: points_camera", self.points_camera, (None, 3), ObservationError, finite=False
        ).astype(float)
        sigma = checks.array(
            f"{where}: points_sigma", self.points_sigma, (len(points),), ObservationError, finite=False
        ).astype(float)
        object.__setattr__(self, "points_camera", points)
        object.__setattr__(self, "points_sigma", sigma)
        checks.instance(f"{where}: rays", self.rays, Rays, ObservationError)
        checks.number(f"{where}: correlation_length", self.correlation_length, _WIDTHS, ObservationError)

    @property
    def points_world(self) -> Float[np.ndarray, "n 3"]:
        return transformed(self.T_world_camera.matrix(), self.points_camera)

    @property
    def points_share(self) -> Float[np.ndarray, "n"]:
        """The part of an independent measurement that each surface point is."""
        return independent_shares(self.points_camera, self.correlation_length, most=0.25)

    @property
    def rays_share(self) -> Float[np.ndarray, "r"]:
        """The part of an independent measurement that each ray is; hits and free rays apart."""
        rays = self.rays
        at = rays.directions_camera * rays.depth[:, None]
        share = np.empty(len(at))
        share[rays.hit] = independent_shares(at[rays.hit], self.correlation_length, most=0.25)
        share[~rays.hit] = independent_shares(at[~rays.hit], self.correlation_length, most=1.0)
        return share

    def at(self, T_world_camera: gtsam.Pose3) -> "ObjectView":
        """The same view, seen from another camera pose."""
        return replace(self, T_world_camera=T_world_camera)

    def thinned(self, points: int, rays: int, seed: int = 0) -> "ObjectView":
        """An even part of this view: what `observe` draws is in an order in which neighbours follow each other."""
        rng = np.random.default_rng(seed)
        some, few = _evenly(rng, len(self.points_camera), points), _evenly(rng, len(self.rays.depth), rays)
        return ObjectView(
            self.frame, self.T_world_camera, self.points_camera[some], self.points_sigma[some],
            self.rays.take(few), self.correlation_length,
        )  # fmt: skip


def thinned(views: Sequence[ObjectView], points: int, rays: int) -> list[ObjectView]:
    """An even part of each view, of so many points and rays together, but of one of each at least."""
    share = max(1, len(views))
    few = max(1, points // share), max(1, rays // share)
    return [view.thinned(*few, seed=i) for i, view in enumerate(views)]


def _evenly(rng: np.random.Generator, n: int, count: int) -> Int[np.ndarray, "m"]:
    """So many at most of n, evenly."""
    return (
        np.arange(n) if n <= count else ((np.arange(count) + rng.uniform()) * n / max(count, 1)).astype(int)
    )


def observe(frame: Frame, instance: int, config: SamplingConfig | None = None, seed: int = 0) -> ObjectView:
    """Sample what `frame` says about the object `instance`.

    Rays: a mask pixel with depth ends on the object; a pixel off the mask leaves the object's place free up to its
    depth, be that behind the object (background) or in front of it (an occluder: it then says nothing of the
    object). A pixel without depth is left out.

    Raises:
        ObservationError: too few usable pixels, a mask that fills the picture, depths that cannot be metres or a
            camera pose that is no rigid motion; the message names the frame and the object.
    """
    config = checks.settings_or_default(config, SamplingConfig, ConfigError)
    checks.instance("frame", frame, Frame, ObservationError)
    checks.whole(f"frame {frame.name}: the id of the object", instance, IDS, ObservationError)
    checks.whole("seed", seed, error=ObservationError)
    where = f"frame {frame.name}, object {instance}"
    T_world_camera = rigid_pose(frame, where)
    depth = clean_depth(frame, where, config.max_depth)
    mask = frame.instances == instance
    on_object = mask & (depth > 0)
    check_mask(mask, on_object, where, config.min_pixels)
    on_object = not_seen_past(depth, without_flying(depth, on_object, config.flying), config.step)
    v, u = np.nonzero(on_object)
    points = frame.intrinsics.backproject(u, v) * depth[v, u, None]
    one = of_one_object(points, config.gap)
    v, u, points = v[one], u[one], points[one]
    if len(points) < config.min_pixels:
        raise ObservationError(
            f"{where}: {len(points)} mask pixels have a steady depth, at least {config.min_pixels} are due; "
            "choose another view"
        )
    rng = np.random.default_rng(seed)
    z = depth[v, u]
    on_object[:] = False
    on_object[v, u] = True
    weight, order = _even_weights(points), _along_curve(u, v)
    chosen = _draw(rng, weight, config.points, order)
    hits = _draw(rng, weight, config.hits, order)
    weight = free_weights(mask, config.margin) * (depth > np.percentile(z, 1))
    free_v, free_u = np.nonzero(weight)
    free = _draw(rng, weight[free_v, free_u], config.free, _along_curve(free_u, free_v))
    free_v, free_u = free_v[free], free_u[free]
    directions = np.concatenate(
        [frame.intrinsics.backproject(u[hits], v[hits]), frame.intrinsics.backproject(free_u, free_v)]
    )
    hit = np.arange(len(directions)) < len(hits)
    at = np.concatenate([z[hits], nearest(depth, on_object)[free_v, free_u]])
    behind = nearest(depth, ~mask)[v[hits], u[hits]]
    end = np.concatenate([behind, depth[free_v, free_u]])
    pixel = config.mask_sigma * at / np.sqrt(frame.intrinsics.fx * frame.intrinsics.fy)
    rays = Rays(directions, at, hit, end, np.hypot(config.noise(at), pixel))
    return ObjectView(
        frame.name,
        T_world_camera,
        points[chosen],
        config.noise(points[chosen, 2]),
        rays,
        config.correlation_length,
    )


def independent_shares(points: Float[np.ndarray, "n 3"], edge: float, most: float) -> Float[np.ndarray, "n"]:
    """The part of an independent measurement that each point is, if all within a cube of that edge are one.

    No point is more than `most`: a stray one must not speak for a whole patch.
    """
    _, inverse, counts = np.unique(voxel_keys(points, edge), return_inverse=True, return_counts=True)
    return np.minimum(1.0 / counts[inverse], most)


def rigid_pose(frame: Frame, where: str) -> gtsam.Pose3:
    """T_world_camera of a frame; raises ObservationError, which begins with `where`, if it is no rigid motion."""
    T = np.asarray(frame.T_world_camera, dtype=float)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ObservationError(f"{where}: the camera pose is not a finite 4x4 matrix; leave the frame out")
    if np.abs(T).max() >= PLACES.most:
        raise ObservationError(
            f"{where}: the camera is more than {PLACES.most / 1000:.0f} km from the world's origin: move the origin near the scan"
        )
    if (why := why_not_rigid(T)) is not None:
        raise ObservationError(f"{where}: the camera pose is no rigid motion: {why}; leave the frame out")
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(T[:3, :3]), T[:3, 3])


def _even_weights(points: Float[np.ndarray, "n 3"], edge: float = 0.03) -> Float[np.ndarray, "n"]:
    """Weights that even out how densely the surface is sampled, so that a thin leg counts beside a wide seat."""
    _, inverse, counts = np.unique(voxel_keys(points, edge), return_inverse=True, return_counts=True)
    return 1.0 / np.sqrt(counts[inverse])


def _draw(
    rng: np.random.Generator, weight: Float[np.ndarray, "n"], count: int, order: Int[np.ndarray, "n"]
) -> Int[np.ndarray, "m"]:
    """So many at most, in this order and evenly along it, the heavier the denser (systematic sampling)."""
    if len(weight) <= count or count == 0:
        return order[:count]
    reached = np.cumsum(weight[order])
    at = (np.arange(count) + rng.uniform()) * (reached[-1] / count)
    return order[np.unique(np.searchsorted(reached, at).clip(max=len(order) - 1))]


def _along_curve(u: Int[np.ndarray, "n"], v: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """An order of pixels in which neighbours follow each other: Morton's curve."""
    key = np.zeros(len(u), dtype=np.int64)
    for bit in range(16):
        key |= (u >> bit & 1) << (2 * bit) | (v >> bit & 1) << (2 * bit + 1)
    return np.argsort(key, kind="stable")
