"""Axes, cameras and points in other frames."""

import numpy as np
from jaxtyping import Float


def perpendicular(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A direction at right angles to another, always the same one; not of unit length."""
    return np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])


def level_axes(up: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit directions at right angles to a unit `up` and to each other; with it they are right-handed."""
    first = perpendicular(up)
    first = first / np.linalg.norm(first)
    return first, np.cross(up, first)


def upright_axes(
    up: Float[np.ndarray, "3"], heading: float | Float[np.ndarray, "*h"]
) -> Float[np.ndarray, "*h 3 3"]:
    """Axes of an upright object as columns: y up, x at `heading` radians about it from a fixed level direction."""
    up = np.asarray(up, float) / np.linalg.norm(up)
    x0 = perpendicular(up)
    x0 /= np.linalg.norm(x0)
    z0 = np.cross(x0, up)
    x = np.multiply.outer(np.cos(heading), x0) - np.multiply.outer(np.sin(heading), z0)
    return np.stack([x, np.broadcast_to(up, x.shape), np.cross(x, up)], axis=-1)


def look_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """T_world_camera of a camera (x right, y down, z forward) at `eye` that looks at another point, level as to `up`.

    Straight up or down any level direction is to the right.
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:
        right = perpendicular(forward)
    right = right / np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


def why_not_rigid(T: Float[np.ndarray, "4 4"], tolerance: float = 1e-2) -> str | None:
    """What keeps a matrix from being a rotation and a translation, None where nothing does.

    The default takes rotations of single precision, or of few digits in a file.
    """
    if not np.isfinite(T).all():
        return "it holds NaN or infinity"
    R = T[:3, :3]
    error = np.abs(R.T @ R - np.eye(3)).max()
    if error > tolerance or np.abs(T[3] - [0, 0, 0, 1]).max() > tolerance:
        return f"it is not rigid (R^T R is off by {error:.2g})"
    return "its rotation is a reflection" if np.linalg.det(R) < 0 else None


def is_rigid(T: Float[np.ndarray, "4 4"], tolerance: float = 1e-4) -> bool:
    """Whether a matrix is a rotation and a translation, by default to the precision of a text file."""
    return why_not_rigid(T, tolerance) is None


def transformed(T_a_b: Float[np.ndarray, "4 4"], p_b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Points of frame b in frame a."""
    return p_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def transformed_back(
    T_a_b: Float[np.ndarray, "4 4"], p_a: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Points of frame a in frame b, for a rigid transform."""
    return (p_a - T_a_b[:3, 3]) @ T_a_b[:3, :3]
