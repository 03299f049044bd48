"""One depth view of a canonical shape: what of it is seen, and how much space around a point is seen to be empty."""

import hashlib
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from factors import checks
from objgraph.errors import ConfigError, PriorError
from objgraph.training.meshes.solid import Solid

_RADIUS = 0.5
"""Of the ball that a shape of diagonal 1 lies in."""
_ELEVATIONS = checks.Range(-89.0, 89.0)
"""From right above or below no direction of the picture is up."""


@dataclass(frozen=True)
class SingleViewConfig:
    """From where a shape is looked at. Lengths in canonical units, angles in degrees."""

    width: int = 240
    """Pixels."""
    height: int = 180
    """Pixels."""
    elevation: tuple[float, float] = (15.0, 40.0)
    """Least and greatest height of the camera above the horizon."""
    distance: tuple[float, float] = (1.5, 2.0)
    """Least and greatest distance of the camera from the box's centre."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some = checks.Range(2)
        checks.settings(
            self, ConfigError, width=some, height=some, elevation=_ELEVATIONS, distance=checks.Range(_RADIUS, open=True)
        )  # fmt: skip


@dataclass(frozen=True)
class DepthView:
    """A noiseless depth picture with a known pose, canonical frame."""

    eye: Float[np.ndarray, "3"]
    directions: Float[np.ndarray, "h w 3"]
    """Unit vectors of the pixels' rays."""
    range: Float[np.ndarray, "h w"]
    """Distance along the ray to the surface; infinite where the ray passes by."""

    @property
    def hit(self) -> Bool[np.ndarray, "h w"]:
        return np.isfinite(self.range)

    @property
    def seen(self) -> Float[np.ndarray, "n 3"]:
        """The surface points of all pixels that show the shape."""
        return self.eye + self.range[self.hit][:, None] * self.directions[self.hit]

    @property
    def pixel(self) -> float:
        """Distance of neighbouring rays at the shape."""
        return float(np.linalg.norm(self.directions[0, 1] - self.directions[0, 0]) * np.linalg.norm(self.eye))


def take_view(solid: Solid, seed: int = 0, config: SingleViewConfig | None = None) -> DepthView:
    """A picture from an azimuth, elevation and distance that the solid's name and the seed decide.

    The azimuth is uniform on the circle; the ball about the shape fills the picture's height.

    Raises:
        PriorError: nothing of the solid is seen.
    """
    config = config or SingleViewConfig()
    name = hashlib.sha256(solid.name.encode()).digest()
    rng = np.random.default_rng([seed, int.from_bytes(name[:8])])
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(*config.elevation))
    distance = rng.uniform(*config.distance)
    level = np.array([np.sin(azimuth), 0.0, -np.cos(azimuth)])
    toward = np.cos(elevation) * level + np.sin(elevation) * np.array([0.0, 1.0, 0.0])
    eye = distance * toward
    directions = _directions(toward, distance, config)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for mesh in solid.surfaces:
        scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    rays = np.concatenate([np.broadcast_to(eye, directions.shape), directions], axis=-1)
    hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy().astype(float)
    if not np.isfinite(hit).any():
        raise PriorError(f"mesh {solid.name}: nothing of it is seen in its view")
    return DepthView(eye, directions, hit)


def free_points(
    view: DepthView, count: int, truncation: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
    """Points in space that was seen to be empty, and lower bounds of their distance to the surface.

    A third lies on rays about outlines, a third on any ray through the shape's ball, a third within
    `truncation` of what is seen. A bound is the distance to the nearest point that is seen or hidden behind
    what is seen, less how far such points are apart, and `truncation` at most.
    """
    near, far = _ball_interval(view)
    end = np.where(view.hit, view.range, far)
    crossing = far > near
    outline = crossing & _about_outlines(view)
    pools = [
        _along(view, _draw(outline, count, rng), near, end, rng),
        _along(view, _draw(crossing, count, rng), near, end, rng),
        _along(view, _draw(view.hit, count, rng), np.maximum(near, end - truncation), end, rng),
    ]
    points = np.concatenate(pools)
    hidden, spacing = _not_empty(view, far)
    distance = cKDTree(hidden).query(points)[0]
    bound = np.clip(distance - spacing, 0.0, truncation)
    row = rng.choice(len(points), count, replace=False)
    return points[row], bound[row]


def _directions(
    toward: Float[np.ndarray, "3"], distance: float, config: SingleViewConfig
) -> Float[np.ndarray, "h w 3"]:
    forward = -toward
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    step = 2 * np.tan(np.arcsin(_RADIUS / distance)) / config.height
    v, u = np.mgrid[: config.height, : config.width]
    x, y = (u - (config.width - 1) / 2) * step, (v - (config.height - 1) / 2) * step
    rays = forward + x[..., None] * right + y[..., None] * down
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _ball_interval(view: DepthView) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Where each ray enters and leaves the ball about the shape; both the nearest point's for rays that miss it."""
    middle = -view.directions @ view.eye
    beside = view.eye @ view.eye - middle**2
    half = np.sqrt(np.maximum((1.05 * _RADIUS) ** 2 - beside, 0.0))
    return middle - half, middle + half


def _about_outlines(view: DepthView, pixels: int = 3, step: float = 0.03) -> Bool[np.ndarray, "h w"]:
    """Pixels near a jump of depth."""
    size = 2 * pixels + 1
    filled = np.where(view.hit, view.range, 1e3)
    return ndimage.maximum_filter(filled, size) - ndimage.minimum_filter(filled, size) > step * size / 3


def _draw(mask: Bool[np.ndarray, "h w"], count: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    pixels = np.argwhere(mask)
    if len(pixels) == 0:
        return np.empty(0, int), np.empty(0, int)
    return tuple(pixels[rng.integers(len(pixels), size=count)].T)


def _along(
    view: DepthView,
    pixels: tuple[np.ndarray, ...],
    start: Float[np.ndarray, "h w"],
    end: Float[np.ndarray, "h w"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    low, high = start[pixels], np.maximum(end, start)[pixels]
    along = low + rng.uniform(size=low.shape) * (high - low)
    return view.eye + along[:, None] * view.directions[pixels]


def _not_empty(
    view: DepthView, far: Float[np.ndarray, "h w"], step: float = 0.01
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Points on and behind the seen surface, and half the diagonal of the cells between them."""
    count = int(np.ceil(2.2 * _RADIUS / step))
    behind = view.range[view.hit][:, None] + step * np.arange(count)
    kept = (behind <= far[view.hit][:, None]) | (np.arange(count) == 0)
    points = view.eye + behind[..., None] * view.directions[view.hit][:, None]
    return points[kept], float(np.sqrt(step**2 + 2 * view.pixel**2) / 2)
