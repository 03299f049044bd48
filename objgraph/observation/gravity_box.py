"""Boxes about an object's points, two faces level."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from objgraph.geometry.frames import upright_axes


@dataclass(frozen=True)
class GravityBox:
    """A box about an object's points, two faces level; or one for each of some headings."""

    centre_world: Float[np.ndarray, "*h 3"]
    size: Float[np.ndarray, "*h 3"]
    """Along the object's x, y (up) and z axes."""
    R_world_object: Float[np.ndarray, "*h 3 3"]

    def __getitem__(self, heading: int) -> "GravityBox":
        """That of one of the headings."""
        return GravityBox(self.centre_world[heading], self.size[heading], self.R_world_object[heading])


def gravity_box(
    points_world: Float[np.ndarray, "n 3"],
    up_world: Float[np.ndarray, "3"],
    heading: float | Float[np.ndarray, "*h"],
    floor: float | None = None,
    floor_reach: float = 0.8,
) -> GravityBox:
    """The box at `heading` radians, or at each of them, that holds the points between their 1st and 99th percentile on every axis.

    Heading 0 turns the object's x axis along an arbitrary but fixed level direction. Where the floor's height is
    known and near, the box stands on it.
    """
    R = upright_axes(up_world, heading)
    low, high = np.percentile(points_world @ R, [1, 99], axis=-2)
    if floor is not None:
        low[..., 1] = np.where(low[..., 1] - floor < floor_reach, floor, low[..., 1])
    middle = R @ (0.5 * (low + high))[..., None]
    return GravityBox(middle[..., 0], np.maximum(high - low, 0.05), R)


def smallest_heading(points_world: Float[np.ndarray, "n 3"], up_world: Float[np.ndarray, "3"]) -> float:
    """Heading at which the gravity box has the smallest footprint."""
    level = points_world @ upright_axes(up_world, 0.0)[:, [0, 2]]
    low, high = np.percentile(level, [1, 99], axis=0)
    inside = level[((level >= low) & (level <= high)).all(axis=1)]
    inside = inside - low  # OpenCV's are single precision: far off they have no angles
    # minAreaRect turns from x towards z; a positive heading turns x towards -z
    return -np.radians(cv2.minAreaRect(inside.astype(np.float32))[2])
