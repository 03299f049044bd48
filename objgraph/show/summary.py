"""Numbers a person asks of an object: where it stands, which way it faces, and how surely.

Covariances are of GTSAM's tangent in the body frame, [rotation, translation], then of what an object or its box has
besides.
"""

import numpy as np
from jaxtyping import Float

_FRONT = np.array([0.0, 0.0, -1.0])
"""The canonical frame's front."""


def position_covariance(
    T_world_object: Float[np.ndarray, "4 4"], covariance: Float[np.ndarray, "9 9"]
) -> Float[np.ndarray, "3 3"]:
    """Covariance of the object's position in the world, m^2: R C_tt R^T."""
    R = T_world_object[:3, :3]
    return R @ covariance[3:6, 3:6] @ R.T


def position_sigma(
    T_world_object: Float[np.ndarray, "4 4"], covariance: Float[np.ndarray, "9 9"]
) -> Float[np.ndarray, "3"]:
    """Standard deviation of the position along the world's axes, metres."""
    return np.sqrt(np.diagonal(position_covariance(T_world_object, covariance)).clip(min=0))


def heading(T_world_object: Float[np.ndarray, "4 4"], up_world: Float[np.ndarray, "3"]) -> float:
    """Angle of the object's front about up in (-pi, pi], radians.

    Counter-clockwise seen from above, zero where the front points along `heading_zero(up_world)`.
    """
    front = T_world_object[:3, :3] @ _FRONT
    zero = heading_zero(up_world)
    return float(np.arctan2(front @ np.cross(up_world, zero), front @ zero))


def heading_zero(up_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The level direction of heading zero: the world's x axis made level, or its z axis where x is up."""
    axis = np.eye(3)[0 if abs(up_world[0]) < 0.9 else 2]
    level = axis - (axis @ up_world) * up_world
    return level / np.linalg.norm(level)


def heading_sigma(
    T_world_object: Float[np.ndarray, "4 4"],
    covariance: Float[np.ndarray, "9 9"],
    up_world: Float[np.ndarray, "3"],
) -> float:
    """Standard deviation of the rotation about up, radians: sqrt(u^T C_rr u) with u = R^T up; pi / sqrt(3), that of headings which
    are all as likely, at most."""
    up_object = T_world_object[:3, :3].T @ up_world
    variance = max(up_object @ covariance[:3, :3] @ up_object, 0.0)
    return float(min(np.sqrt(variance), np.pi / np.sqrt(3)))
