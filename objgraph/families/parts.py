"""Closed parts from which the procedural families are put together; metres, y up, front at -z."""

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.geometry.meshes import signed_volume

Vector = Sequence[float] | Float[np.ndarray, "3"]

SECTIONS = 12


def loft(rings: Float[np.ndarray, "k m 3"]) -> trimesh.Trimesh:
    """The closed solid through k rings of m points each, its ends capped by fans about their centres."""
    k, m, _ = rings.shape
    here = np.arange(m)
    after = (here + 1) % m
    quads = []
    for i in range(k - 1):
        a, b, c, d = i * m + here, i * m + after, (i + 1) * m + after, (i + 1) * m + here
        quads += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    first, last = k * m, k * m + 1
    quads.append(np.stack([np.full(m, first), after, here], 1))
    quads.append(np.stack([np.full(m, last), (k - 1) * m + here, (k - 1) * m + after], 1))
    vertices = np.concatenate([rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    mesh = trimesh.Trimesh(vertices, np.concatenate(quads), process=False)
    if signed_volume(mesh) < 0:
        mesh.invert()
    return mesh


def box(size: Vector, centre: Vector, pitch: float = 0.0, yaw: float = 0.0) -> trimesh.Trimesh:
    """A box; `pitch` tips its top towards +z, `yaw` turns it about y, both about its own centre."""
    mesh = trimesh.creation.box(extents=np.asarray(size, float))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(pitch, [1, 0, 0]))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(yaw, [0, 1, 0]))
    mesh.apply_translation(np.asarray(centre, float))
    return mesh


def tube(
    path: Sequence[Vector] | Float[np.ndarray, "k 3"],
    radius: float | Sequence[float],
    aspect: float = 1.0,
    sections: int = SECTIONS,
) -> trimesh.Trimesh:
    """A rod along a polyline; `radius` may change along it, `aspect` flattens it, 4 sections make it square."""
    points = np.asarray(path, float)
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    start = np.array([1.0, 0.0, 0.0]) if abs(tangents[0, 0]) < 0.8 else np.array([0.0, 1.0, 0.0])
    angles = 2 * np.pi * (np.arange(sections) + 0.5) / sections
    radii = np.broadcast_to(np.asarray(radius, float), len(points))
    stretch = np.sqrt(2.0) if sections == 4 else 1.0
    rings = []
    side = start
    for point, tangent, r in zip(points, tangents, radii, strict=True):
        side = side - side @ tangent * tangent
        side /= np.linalg.norm(side)
        up = np.cross(tangent, side)
        rings.append(
            point + stretch * r * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles) * aspect, up))
        )
    return loft(np.stack(rings))


def rod(start: Vector, end: Vector, radius: float, end_radius: float | None = None, sections: int = SECTIONS):
    """A straight, possibly tapering, rod between two points."""
    return tube([start, end], [radius, radius if end_radius is None else end_radius], sections=sections)


def lathe(profile: Sequence[tuple[float, float]], x: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    """A solid of revolution about the vertical through (x, z); the profile lists (radius, height)."""
    angles = 2 * np.pi * np.arange(24) / 24
    circle = np.stack([np.cos(angles), np.zeros(24), np.sin(angles)], 1)
    return loft(np.stack([circle * max(r, 1e-3) + [x, y, z] for r, y in profile]))


def outline(width: float, depth: float, exponent: float, points: int = 32) -> Float[np.ndarray, "m 2"]:
    """A horizontal outline in (x, z), star-shaped about its centre.

    Exponents below 8 give a superellipse (2 is an ellipse); from 8 on a rectangle whose corners are rounded
    by its shorter side over the exponent.
    """
    if exponent < 8:
        angle = 2 * np.pi * (np.arange(points) + 0.5) / points
        direction = np.stack([np.cos(angle), np.sin(angle)], 1)
        reach = (np.abs(direction) ** exponent).sum(1) ** (-1 / exponent)
        return direction * reach[:, None] * [width / 2, depth / 2]
    radius = min(width, depth) / exponent
    angle = np.linspace(0, np.pi / 2, 5)
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], 1) + [width / 2 - radius, depth / 2 - radius]
    half = np.concatenate([arc, arc[::-1] * [-1, 1]])
    return np.concatenate([half, -half])


def slab(
    shape: Float[np.ndarray, "m 2"], y_bottom: float, y_top: float, bevel: float = 0.0, crown: float = 0.0
) -> trimesh.Trimesh:
    """A horizontal plate of a star-shaped outline (x, z); `bevel` rounds its edges, `crown` domes its top."""
    bevel = min(bevel, 0.49 * (y_top - y_bottom))
    shrink = 1 - bevel / np.abs(shape).max()
    levels = [(1.0, y_bottom), (1.0, y_top)]
    if bevel > 0:
        middle = (1 + shrink) / 2
        levels = [
            (shrink, y_bottom),
            (1 - (1 - middle) * 0.3, y_bottom + 0.5 * bevel),
            (1.0, y_bottom + bevel),
            (1.0, y_top - bevel),
            (1 - (1 - middle) * 0.3, y_top - 0.5 * bevel),
            (shrink, y_top),
        ]
    if crown > 0:
        levels += [(0.6 * shrink, y_top + 0.7 * crown), (0.2 * shrink, y_top + crown)]
    rings = [np.stack([s * shape[:, 0], np.full(len(shape), y), s * shape[:, 1]], 1) for s, y in levels]
    return loft(np.stack(rings))


def panel(
    widths: Sequence[float] | Float[np.ndarray, "k"],
    heights: Sequence[float] | Float[np.ndarray, "k"],
    depths: Sequence[float] | Float[np.ndarray, "k"],
    thickness: float,
    wrap: float = 0.0,
    columns: int = 9,
) -> trimesh.Trimesh:
    """An upright curved plate: at every height its width, the z of its middle, and edges `wrap` further to -z."""
    u = np.linspace(-1, 1, columns)
    rings = []
    for width, y, z in zip(widths, heights, depths, strict=True):
        x = u * width / 2
        # the edge thins out a little, as upholstered and moulded ones do
        half = thickness / 2 * (1 - 0.3 * u**4)
        mid = z - wrap * u**2
        front = np.stack([x, np.full(columns, y), mid - half], 1)
        back = np.stack([x, np.full(columns, y), mid + half], 1)[::-1]
        rings.append(np.concatenate([front, back]))
    return loft(np.stack(rings))


def moved(mesh: trimesh.Trimesh, offset: Vector) -> trimesh.Trimesh:
    """A copy, translated."""
    copy = mesh.copy()
    copy.apply_translation(np.asarray(offset, float))
    return copy


def mirrored(parts: Sequence[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """The parts and their mirror images in x."""
    images = []
    for part in parts:
        image = part.copy()
        image.vertices = image.vertices * [-1, 1, 1]
        image.invert()
        images.append(image)
    return [*parts, *images]


def smooth_path(knots: Sequence[Vector], radius: float, steps: int = 5) -> Float[np.ndarray, "k 3"]:
    """The polyline through `knots` with its corners rounded by quadratic arcs, as bent tubes have."""
    points = np.asarray(knots, float)
    path = [points[0]]
    for before, corner, after in zip(points[:-2], points[1:-1], points[2:], strict=True):
        reach_in = min(radius, 0.45 * np.linalg.norm(corner - before))
        reach_out = min(radius, 0.45 * np.linalg.norm(after - corner))
        a = corner + reach_in * (before - corner) / np.linalg.norm(before - corner)
        b = corner + reach_out * (after - corner) / np.linalg.norm(after - corner)
        for t in np.linspace(0, 1, steps):
            path.append((1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b)
    path.append(points[-1])
    return np.stack(path)


def ring_path(radius: float, y: float) -> Float[np.ndarray, "k 3"]:
    """A horizontal circle, as the path of a footrest's tube."""
    angles = np.linspace(0, 2 * np.pi, 25)
    return np.stack([radius * np.cos(angles), np.full(25, y), radius * np.sin(angles)], 1)


def canonical(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh in the canonical frame: bounding box centred, its diagonal 1."""
    mesh: trimesh.Trimesh = trimesh.util.concatenate(list(parts))  # pyright: ignore[reportAssignmentType]
    low, high = mesh.bounds
    mesh.apply_translation(-(low + high) / 2)
    mesh.apply_scale(1.0 / np.linalg.norm(high - low))
    return mesh
