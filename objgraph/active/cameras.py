"""Cameras to choose among: about an object, or wherever the caller can go."""

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.checks import PLACES
from objgraph.errors import ActiveVisionError
from objgraph.geometry.frames import level_axes, look_at

Reachable = Callable[[gtsam.Pose3], bool]
"""Says of T_world_camera whether a camera can be brought there."""
_GOLDEN = np.pi * (3 - np.sqrt(5))


def looking_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up_world: Float[np.ndarray, "3"]
) -> gtsam.Pose3:
    """T_world_camera of a level camera (x right, y down, z forward) at `eye` whose axis goes through `target`.

    Raises:
        ActiveVisionError: the two are one point.
    """
    eye = checks.reals("eye", eye, (3,), PLACES, ActiveVisionError)
    target = checks.reals("target", target, (3,), PLACES, ActiveVisionError)
    if not np.linalg.norm(target - eye) > 1e-9:
        raise ActiveVisionError(f"a camera at {eye} cannot look at the point where it is")
    return gtsam.Pose3(look_at(eye, target, checks.direction("up_world", up_world, ActiveVisionError)))


def sphere(
    centre: Float[np.ndarray, "3"],
    radius: float,
    up_world: Float[np.ndarray, "3"],
    count: int,
    elevations: tuple[float, float] = (0.0, 75.0),
) -> list[gtsam.Pose3]:
    """`count` cameras that look at `centre` from a distance, evenly spread between two elevations in degrees.

    Raises:
        ActiveVisionError: there are none, the radius is not positive, or the elevations do not rise within -90 to 90.
    """
    centre = checks.reals("centre", centre, (3,), PLACES, ActiveVisionError)
    checks.whole("the count of cameras on a sphere", count, checks.Range(1, 10**6), ActiveVisionError)
    checks.number("the radius of a sphere of cameras", radius, checks.Range(1e-6, 1e6), ActiveVisionError)
    low, high = checks.reals(
        "the elevations of cameras on a sphere", elevations, (2,), checks.Range(-90, 90), ActiveVisionError
    )
    if low > high:
        raise ActiveVisionError(
            f"the elevations of cameras on a sphere must rise, not go from {low:g} to {high:g}"
        )
    up = checks.direction("up_world", up_world, ActiveVisionError)
    east, north = level_axes(up)
    steps = np.arange(count)
    # equal areas of the zone: the sine of the elevation rises evenly
    sine = np.sin(np.radians(low)) + (steps + 0.5) / count * (
        np.sin(np.radians(high)) - np.sin(np.radians(low))
    )
    level = np.sqrt(1 - sine**2)
    bearing = _GOLDEN * steps
    away = (
        level[:, None] * (np.cos(bearing)[:, None] * east + np.sin(bearing)[:, None] * north)
        + sine[:, None] * up
    )
    return [looking_at(centre + radius * each, centre, up) for each in away]


def reachable(cameras: Sequence[gtsam.Pose3], can_reach: Reachable | None) -> list[gtsam.Pose3]:
    """Those that the callback lets pass; raises ActiveVisionError where none does."""
    kept = [camera for camera in cameras if can_reach is None or can_reach(camera)]
    if not kept:
        raise ActiveVisionError(f"none of {len(cameras)} cameras can be reached; offer others")
    return kept
