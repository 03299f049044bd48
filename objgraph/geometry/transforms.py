"""Rigid 4x4 transforms: points through them, and the pose of a camera that looks at something."""

import numpy as np
from jaxtyping import Float

from objgraph.geometry.axes import camera_axes


def transform_points(
    T_a_b: Float[np.ndarray, "4 4"], p_b: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Points of frame b in frame a."""
    return p_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def transform_points_back(
    T_a_b: Float[np.ndarray, "4 4"], p_a: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Points of frame a in frame b: the inverse of `transform_points` without inverting anything."""
    return (p_a - T_a_b[:3, 3]) @ T_a_b[:3, :3]


def look_at(
    eye_world: Float[np.ndarray, "3"], target_world: Float[np.ndarray, "3"], up_world: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """T_world_camera of a level camera (OpenCV axes) at one point whose axis goes through another."""
    forward = np.asarray(target_world, float) - eye_world
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = camera_axes(forward / np.linalg.norm(forward), up_world)
    T_world_camera[:3, 3] = eye_world
    return T_world_camera
