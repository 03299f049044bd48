"""Closed solids that furniture is put together from; lengths in metres, floor at y = 0."""

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from objgraph.geometry.frames import perpendicular
from objgraph.geometry.meshes import signed_volume

Point = Sequence[float]


def box(low: Point, high: Point) -> trimesh.Trimesh:
    """An axis-aligned box between two corners."""
    return trimesh.creation.box(bounds=[list(low), list(high)])


def column(
    radius: float, bottom: float, top: float, sections: int = 32, turn: float = 0.0, taper: float = 1.0
) -> trimesh.Trimesh:
    """An upright prism about the y axis; `taper` is the radius at the bottom relative to that at the top."""
    angles = turn + 2 * np.pi * np.arange(sections) / sections
    ring = np.column_stack([np.cos(angles), np.zeros(sections), np.sin(angles)])
    rings = [ring * radius * taper + [0, bottom, 0], ring * radius + [0, top, 0]]
    return _skin(np.stack(rings))


def beam(path: ArrayLike, radii: ArrayLike, sections: int = 10) -> trimesh.Trimesh:
    """A round bar along a path of points; four sections make it square. `radii`: one, or one a point."""
    points = np.asarray(path, dtype=float)
    radius = np.broadcast_to(np.asarray(radii, dtype=float), len(points))
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    angles = 2 * np.pi * (np.arange(sections) + 0.5) / sections
    side = perpendicular(tangents[0])
    rings = []
    for point, tangent, r in zip(points, tangents, radius, strict=True):
        # the last ring's axes, carried along without twisting
        side = side - tangent * (side @ tangent)
        side /= np.linalg.norm(side)
        other = np.cross(tangent, side)
        rings.append(point + r * (np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other))
    return _skin(np.stack(rings))


def sheet(surface: Float[np.ndarray, "m n 3"], thickness: float) -> trimesh.Trimesh:
    """A curved plate: the grid of points, thickened half to either side along its normals."""
    du, dv = np.gradient(surface, axis=0), np.gradient(surface, axis=1)
    normals = np.cross(du, dv)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    front, back = surface + normals * thickness / 2, surface - normals * thickness / 2
    # a ring for every row: along the front and home along the back
    return _skin(np.concatenate([front, back[:, ::-1]], axis=1))


def rounded(path: ArrayLike, radius: float, steps: int = 4) -> Float[np.ndarray, "n 3"]:
    """The path with its inner corners replaced by parabolic arcs that begin `radius` before them."""
    points = np.asarray(path, dtype=float)
    result = [points[0]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        a, b = _towards(corner, before, radius), _towards(corner, after, radius)
        t = np.linspace(0, 1, steps + 1)[:, None]
        result.extend((1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b)
    return np.array([*result, points[-1]])


def arc(start: Point, middle: Point, end: Point, steps: int = 8) -> Float[np.ndarray, "n 3"]:
    """A parabola through three points."""
    t = np.linspace(0, 1, steps + 1)[:, None]
    a, b, c = (np.asarray(p, dtype=float) for p in (start, middle, end))
    return (2 * t - 1) * (t - 1) * a + 4 * t * (1 - t) * b + t * (2 * t - 1) * c


def oval(half_x: float, half_z: float, bottom: float, top: float, power: float = 2.0) -> trimesh.Trimesh:
    """An upright plate with a superelliptic outline: power 2 is an ellipse, 4 nearly a rectangle."""
    angles = 2 * np.pi * np.arange(40) / 40
    c, s = np.cos(angles), np.sin(angles)
    x = half_x * np.sign(c) * np.abs(c) ** (2 / power)
    z = half_z * np.sign(s) * np.abs(s) ** (2 / power)
    rings = [np.column_stack([x, np.full(40, y), z]) for y in (bottom, top)]
    return _skin(np.stack(rings))


def join(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of all parts, each with its normals outwards; parts may overlap."""
    for part in parts:
        if signed_volume(part) < 0:
            part.invert()
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + offset for part, offset in zip(parts, offsets, strict=False)]
    return trimesh.Trimesh(
        np.concatenate([part.vertices for part in parts]), np.concatenate(faces), process=False
    )


def _skin(rings: Float[np.ndarray, "m k 3"]) -> trimesh.Trimesh:
    """The closed surface through m rings of k points, with a fan over either end."""
    m, k, _ = rings.shape
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    return trimesh.Trimesh(vertices, _skin_faces(m, k), process=False)


def _skin_faces(m: int, k: int) -> Int[np.ndarray, "f 3"]:
    index = np.arange(m * k).reshape(m, k)
    following = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1].ravel(), following[:-1].ravel(), following[1:].ravel(), index[1:].ravel()
    first, last = np.full(k, m * k), np.full(k, m * k + 1)
    return np.concatenate(
        [
            np.column_stack([a, b, c]),
            np.column_stack([a, c, d]),
            np.column_stack([first, following[0], index[0]]),
            np.column_stack([last, index[-1], following[-1]]),
        ]
    )


def _towards(corner: np.ndarray, other: np.ndarray, distance: float) -> np.ndarray:
    away = other - corner
    return corner + away * min(distance / np.linalg.norm(away), 0.5)
