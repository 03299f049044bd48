"""Where to stand: cameras that have given points well in the picture."""

import numpy as np
from jaxtyping import Float

from objgraph.geometry.frames import look_at
from objgraph.observation.frames import Intrinsics
from objgraph.show.raster import Camera
from objgraph.show.summary import heading_zero

_FIELD_OF_VIEW = np.radians(38)
"""Vertical."""


def intrinsics_for(width: int, height: int) -> Intrinsics:
    """A camera of the pictures' field of view."""
    f = height / 2 / np.tan(_FIELD_OF_VIEW / 2)
    return Intrinsics(f, f, (width - 1) / 2, (height - 1) / 2, width, height)


def oblique_direction(
    up_world: Float[np.ndarray, "3"], azimuth: float, elevation: float
) -> Float[np.ndarray, "3"]:
    """Unit vector from the scene to the camera; azimuth counts as `summary.heading` does. Radians."""
    zero = heading_zero(up_world)
    level = np.cos(azimuth) * zero + np.sin(azimuth) * np.cross(up_world, zero)
    return np.cos(elevation) * level + np.sin(elevation) * up_world


def level_axis_across(
    p_world: Float[np.ndarray, "n 3"], up_world: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """What should point up in a picture from above for the points' longer side to lie across it."""
    zero = heading_zero(up_world)
    other = np.cross(up_world, zero)
    return zero if np.ptp(p_world @ zero) < np.ptp(p_world @ other) else other


def framing_camera(
    p_world: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
    fill: float = 0.85,
) -> Camera:
    """The nearest camera, looking against `direction`, that has all points in the middle `fill` of its picture."""
    low, high = p_world.min(axis=0), p_world.max(axis=0)
    target = (low + high) / 2
    axes = look_at(target + direction, target, up)[:3, :3]
    x, y, z = ((p_world - target) @ axes).T
    target = target + axes @ [(x.min() + x.max()) / 2, (y.min() + y.max()) / 2, 0.0]
    x, y = x - (x.min() + x.max()) / 2, y - (y.min() + y.max()) / 2
    half_width = fill * intrinsics.width / 2 / intrinsics.fx
    half_height = fill * intrinsics.height / 2 / intrinsics.fy
    distance = max(np.max(np.abs(x) / half_width - z), np.max(np.abs(y) / half_height - z), 0.3)
    return Camera(intrinsics, look_at(target + distance * direction, target, up))
