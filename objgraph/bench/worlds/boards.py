"""Boards and turned parts of the benchmark's furniture; lengths in metres, floor at y = 0."""

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from objgraph.synthetic.parts import beam, sheet

SIDES = (-1.0, 1.0)


def strip(path: ArrayLike, across: ArrayLike, thickness: float) -> trimesh.Trimesh:
    """A board along a path of points; `across` is half its width as a vector: one, or one a point."""
    points = np.asarray(path, dtype=float)
    half = np.broadcast_to(np.asarray(across, dtype=float), points.shape)
    return sheet(points[:, None] + np.array([-1.0, 0.0, 1.0])[:, None] * half[:, None], thickness)


def lathe(profile: ArrayLike, x: float = 0.0, z: float = 0.0, sections: int = 24) -> trimesh.Trimesh:
    """A turned part about the vertical through (x, z); the profile's rows are (radius, height), upwards."""
    radius, height = np.asarray(profile, dtype=float).T
    return beam(np.column_stack([np.full_like(height, x), height, np.full_like(height, z)]), radius, sections)


def half_round(half_x: float, depth: float, z: float, bottom: float, top: float) -> trimesh.Trimesh:
    """A plate whose straight edge runs along x at `z` and whose round side reaches `depth` towards -z."""
    angle, share = np.meshgrid(np.linspace(0.06, np.pi - 0.06, 33), [0.0, 0.5, 1.0], indexing="ij")
    x, reach = -half_x * np.cos(angle), depth * np.sin(angle)
    return sheet(np.stack([x, np.full_like(x, (bottom + top) / 2), z - share * reach], axis=-1), top - bottom)


def ring(
    radii: Sequence[float], y: float, thickness: float, sweep: float = 2 * np.pi, steps: int = 48
) -> trimesh.Trimesh:
    """A level bar bent along an ellipse with half axes (x, z), `sweep` radians long, its middle at +z."""
    path = [
        (radii[0] * np.sin(a), y, radii[1] * np.cos(a)) for a in np.linspace(-sweep / 2, sweep / 2, steps)
    ]
    return beam(path, thickness, 8)


def smooth(knots: ArrayLike, steps: int = 16) -> Float[np.ndarray, "n 3"]:
    """A curve through points that overshoots none of them."""
    points = np.asarray(knots, dtype=float)
    at = np.concatenate([[0.0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=1)))])
    return PchipInterpolator(at, points)(np.linspace(0, at[-1], steps))
