"""A box as KITTI's object benchmark writes it (Geiger et al., CVPR 2012)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objgraph.geometry.boxes import OrientedBox

_CAMERA_FROM_OBJECT = np.array([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Axes of an object that faces along the camera's x axis: its x (right), y (up) and z (back) in the camera's."""


@dataclass(frozen=True)
class KittiBox:
    """One line of a label or a result file; lengths in metres, angles in radians, the rectified camera's frame."""

    type: str
    truncation: float
    """Share of the object outside the picture; -1 in a detector's file."""
    occlusion: int
    """0 fully seen, 1 partly, 2 largely hidden, 3 unknown; -1 in a detector's file."""
    image_box: Float[np.ndarray, "4"]
    """Left, top, right, bottom, pixels."""
    height: float
    width: float
    length: float
    bottom: Float[np.ndarray, "3"]
    """Middle of the box' lower side."""
    yaw: float
    """About the camera's downward y axis; 0 faces along its x axis."""
    score: float | None

    @property
    def T_rect_object(self) -> Float[np.ndarray, "4 4"]:
        """The box' middle and the priors' axes (x right of the driver, y up, z back) in the rectified camera's frame."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        T = np.eye(4)
        T[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ _CAMERA_FROM_OBJECT
        T[:3, 3] = self.bottom - [0, self.height / 2, 0]
        return T

    @property
    def box(self) -> OrientedBox:
        """In the rectified camera's frame."""
        T = self.T_rect_object
        return OrientedBox(T[:3, 3], T[:3, :3], self.size)

    @property
    def size(self) -> Float[np.ndarray, "3"]:
        """Edges along the object's x, y and z."""
        return np.array([self.width, self.height, self.length])
