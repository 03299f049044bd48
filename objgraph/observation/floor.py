"""The floor's height from scene depth: what objects stand on."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from objgraph.geometry.frames import level_axes

_CELL = 0.1
_BIN = 0.01
_REACH = 500.0
"""Metres above and below the middle of all points beyond which nothing is of the scene."""


@dataclass(frozen=True)
class FloorConfig:
    """When a horizontal layer of points is the floor."""

    thickness: float = 0.05
    """Thickness of the layer, metres: sensor noise, uneven floors and a slightly tilted `up`."""
    min_area: float = 0.5
    """Ground area that the layer's points must cover, square metres."""
    min_contrast: float = 2.0
    """Times that the layer must cover the area of the layer above it: a wall covers the same at every height."""
    max_below: float = 0.15
    """Area, as a share of the layer's, that points under it may cover: stray points and reflections."""


def estimate_floor(
    points_world: Float[np.ndarray, "n 3"],
    up_world: Float[np.ndarray, "3"],
    config: FloorConfig | None = None,
) -> float | None:
    """Height of the floor along `up_world`, metres (the floor: `up_world . p = height`); None where none is seen.

    `points_world` are points of the whole scene, objects and all, in any density: what counts is the ground
    area that points of about one height cover, in cells of 10 cm, not their number. The floor is the lowest
    layer that covers at least `min_area`, stands out from the layer above it and has next to nothing below.
    Without the floor in view the lowest wide surface with nothing under it (a table top alone) looks the same.
    """
    config = config or FloorConfig()
    points = points_world[np.isfinite(points_world).all(axis=1)]
    if len(points) < 3:
        return None
    up = np.asarray(up_world, dtype=float) / np.linalg.norm(up_world)
    heights = points @ up
    near = np.abs(heights - np.median(heights)) < _REACH
    points, heights = points[near], heights[near]
    if len(points) < 3:
        return None
    cells = _ground_cells(points, up)
    for height in _layers(heights, cells, config.thickness):
        distance = heights - height
        inside = np.abs(distance) <= config.thickness / 2
        area = _area(cells[inside])
        above = _area(cells[np.abs(distance - 1.5 * config.thickness) <= config.thickness / 2])
        below = _area(cells[distance < -config.thickness])
        stands_out = area >= max(config.min_area, config.min_contrast * above)
        if stands_out and below <= config.max_below * area:
            return float(np.median(heights[inside]))
    return None


def _ground_cells(points: Float[np.ndarray, "n 3"], up: Float[np.ndarray, "3"]) -> Int[np.ndarray, "n"]:
    """The number of the ground cell under each point."""
    ground = np.stack([points @ axis for axis in level_axes(up)], axis=1)
    column, row = np.floor((ground - ground.min(axis=0)) / _CELL).astype(np.int64).T
    return column * (row.max() + 1) + row


def _layers(
    heights: Float[np.ndarray, "n"], cells: Int[np.ndarray, "n"], thickness: float
) -> Float[np.ndarray, "k"]:
    """Heights at which a layer of that thickness covers locally the most ground, from the lowest up."""
    bins = np.floor((heights - heights.min()) / _BIN).astype(np.int64)
    occupied = np.unique(np.stack([bins, cells], axis=1), axis=0)[:, 0]
    margin = round(thickness / _BIN)
    counts = np.pad(np.bincount(occupied).astype(float), margin)
    smooth = uniform_filter1d(counts, margin, mode="constant")
    highest = maximum_filter1d(smooth, 2 * margin + 1, mode="constant")
    peaks = np.flatnonzero((smooth == highest) & (smooth > 0)) - margin
    return heights.min() + (peaks + 0.5) * _BIN


def _area(cells: Int[np.ndarray, "n"]) -> float:
    """Ground area of the distinct cells, square metres."""
    return len(np.unique(cells)) * _CELL**2
