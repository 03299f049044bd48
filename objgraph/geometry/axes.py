"""Directions across others: what is level, what is upright, and how a camera is held. Vectors are of the world."""

import numpy as np
from jaxtyping import Float

_VERTICAL = 1e-6
"""Sine of the angle to the vertical under which a gaze has no level right of its own."""


def farthest_axis(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The coordinate axis that lies most across a direction; the first of equal ones."""
    return np.eye(3)[np.argmin(np.abs(direction))]


def perpendicular(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A unit vector across a direction, always the same one."""
    across = np.cross(direction, farthest_axis(direction))
    return across / np.linalg.norm(across)


def level_axes(up_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two level unit vectors as rows, right-handed with the unit vector up: east and north, arbitrary but fixed."""
    east = perpendicular(up_world)
    return np.stack([east, np.cross(up_world, east)])


def upright_axes(up_world: Float[np.ndarray, "3"], heading: float) -> Float[np.ndarray, "3 3"]:
    """R_world_object of an object whose y is up and whose x lies at `heading` radians about it."""
    up = np.asarray(up_world, float) / np.linalg.norm(up_world)
    x0 = perpendicular(up)
    z0 = np.cross(x0, up)
    x = np.cos(heading) * x0 - np.sin(heading) * z0
    return np.stack([x, up, np.cross(x, up)], axis=1)


def camera_axes(
    forward_world: Float[np.ndarray, "3"], up_world: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3"]:
    """R_world_camera (OpenCV: x right, y down, z forward) of a level camera; `forward_world` is a unit vector.

    Straight up or down, any level direction is to the right.
    """
    right = np.cross(forward_world, up_world)
    length = np.linalg.norm(right)
    right = perpendicular(forward_world) if length < _VERTICAL else right / length
    return np.stack([right, np.cross(forward_world, right), forward_world], axis=1)
