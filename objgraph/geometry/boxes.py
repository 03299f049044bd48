"""Oriented boxes and the exact intersection over union of two of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from objgraph.errors import GeometryError

_THINNEST = 1e-9  # radius, relative to the larger box, under which two boxes only touch
_THIN = 1e-5  # and under which the hull of what they share may fail; it holds a share of 1e-5 at most


@dataclass(frozen=True)
class OrientedBox:
    """A box in the world frame; `rotation` has its axes as columns."""

    centre: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    extents: Float[np.ndarray, "3"]
    """Full side lengths, metres."""

    def __post_init__(self) -> None:
        if not np.isfinite(self.extents).all() or np.min(self.extents) <= 0:
            raise GeometryError(f"a box must have positive side lengths, got {self.extents}")

    @staticmethod
    def about(p_world: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "3 3"]) -> "OrientedBox":
        """The smallest along the columns of `rotation` that holds all points."""
        low, high = (p_world @ rotation).min(axis=0), (p_world @ rotation).max(axis=0)
        return OrientedBox(rotation @ ((low + high) / 2), rotation, high - low)

    @property
    def volume(self) -> float:
        return float(np.prod(self.extents))

    def contains(self, p_world: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points lie in the box, its faces included."""
        return np.all(np.abs((p_world - self.centre) @ self.rotation) <= self.extents / 2, axis=1)

    def halfspaces(self, origin: Float[np.ndarray, "3"]) -> Float[np.ndarray, "6 4"]:
        """Rows [n, b] with n (p - origin) + b <= 0 for points p of the box."""
        normals = np.concatenate([self.rotation.T, -self.rotation.T])
        offsets = normals @ (self.centre - origin) + np.tile(self.extents / 2, 2)
        return np.column_stack([normals, -offsets])


def box_iou(a: OrientedBox, b: OrientedBox) -> float:
    """Intersection over union of two oriented boxes, in [0, 1]."""
    intersection = intersection_volume(a, b)
    return float(np.clip(intersection / (a.volume + b.volume - intersection), 0.0, 1.0))


def intersection_volume(a: OrientedBox, b: OrientedBox) -> float:
    """Volume, in cubic metres, of the convex body that both boxes share; 0 where they only touch."""
    size = max(a.extents.max(), b.extents.max())
    if np.linalg.norm(a.centre - b.centre) > (np.linalg.norm(a.extents) + np.linalg.norm(b.extents)) / 2:
        return 0.0
    halfspaces = np.concatenate([a.halfspaces(a.centre), b.halfspaces(a.centre)])
    halfspaces[:, 3] /= size
    interior = _deepest_point(halfspaces)
    if interior is None:
        return 0.0
    try:
        corners = HalfspaceIntersection(halfspaces, interior[:3]).intersections
        return float(ConvexHull(corners).volume) * size**3
    except QhullError:
        if interior[3] > _THIN:
            raise
        return 0.0  # what they share is too thin for its corners to be told apart


def _deepest_point(halfspaces: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "4"] | None:
    """Centre and radius of the largest inscribed ball, or None where there is none."""
    # unit normals, so the ball's radius enters every row with weight one
    rows = np.column_stack([halfspaces[:, :3], np.ones(len(halfspaces))])
    bounds = [(None, None)] * 3 + [(0, None)]
    result = linprog([0, 0, 0, -1], A_ub=rows, b_ub=-halfspaces[:, 3], bounds=bounds)
    if not result.success or result.x[3] <= _THINNEST:
        return None
    return result.x
