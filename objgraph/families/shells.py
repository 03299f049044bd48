"""Chairs whose seat and back are one bent sheet, from bar stools on wire to zigzags that are all sheet."""

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from objgraph.families.parts import canonical, loft, mirrored, ring_path, rod, smooth_path, tube
from objgraph.families.supports import cantilever, column, corner_legs, rails, sled

Parts = list[trimesh.Trimesh]


def bent_sheet(
    path: Float[np.ndarray, "k 3"],
    widths: Float[np.ndarray, "k"],
    thickness: float,
    wrap: Float[np.ndarray, "k"],
    columns: int = 9,
) -> trimesh.Trimesh:
    """A sheet along a path in the plane x = 0, from a seat's front to a back's top.

    Its edges rise by `wrap` towards the sitter.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([np.zeros(len(path)), tangent[:, 2], -tangent[:, 1]], 1)
    u = np.linspace(-1, 1, columns)
    rings = []
    for point, across, width, rise in zip(path, normal, widths, wrap, strict=True):
        middle = point + np.outer(u * width / 2, [1, 0, 0]) + np.outer(rise * u**2, across)
        half = 0.5 * thickness * across
        rings.append(np.concatenate([middle + half, (middle - half)[::-1]]))
    return loft(np.array(rings))


def seat_shell(rng: Generator, width: float, depth: float, y: float, reach: float) -> trimesh.Trimesh:
    """A bent seat with its back: plywood of one width, a bucket, or a pad."""
    slope = rng.uniform(0.05, 0.4)
    drop = rng.uniform(0.0, 0.04)
    knots = [[0, y - drop, -depth / 2], [0, y, -depth / 2 + 0.06], [0, y - rng.uniform(0, 0.03), depth / 2]]
    knots.append([0, y + reach, depth / 2 + slope * reach])
    if rng.random() < 0.3:
        knots.append([0, y + reach + 0.03, depth / 2 + slope * reach + 0.04])
    path = smooth_path(knots, rng.uniform(0.05, 0.16), 7)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    share = length / length[-1]
    widths = width * np.interp(
        share, [0, 0.25, 0.5, 0.8, 1], [rng.uniform(0.7, 1), 1, *rng.uniform(0.75, 1.02, 3)]
    )
    bucket = rng.uniform(0.02, 0.13) * (rng.random() < 0.5)
    wrap = bucket * np.sin(np.pi * np.clip(share, 0.05, 0.97)) ** 0.7
    if bucket:
        widths = widths * np.interp(share, [0, 0.1, 0.85, 1], [0.8, 1, 1, rng.uniform(0.45, 0.9)])
    return bent_sheet(path, widths, rng.choice([rng.uniform(0.01, 0.025), rng.uniform(0.03, 0.09)]), wrap)


def bent_shell_chair(rng: Generator) -> trimesh.Trimesh:
    """A one-piece seat and back at chair or bar height on legs, a sled, a cantilever or a column."""
    high = rng.random() < 0.35
    y = rng.uniform(0.6, 0.8) if high else rng.uniform(0.40, 0.48)
    width, depth = rng.uniform(0.36, 0.52), rng.uniform(0.34, 0.46)
    reach = rng.uniform(0.15, 0.45) if high else rng.uniform(0.3, 0.6)
    parts = [seat_shell(rng, width, depth, y, reach)]
    x, z, r = width * rng.uniform(0.3, 0.46), depth * rng.uniform(0.28, 0.46), rng.uniform(0.006, 0.022)
    under = y - 0.012
    kind = rng.choice(["legs", "sled", "cantilever", "column"], p=[0.45, 0.25, 0.15, 0.15])
    if kind == "legs":
        legs, spread = corner_legs(rng, x, z, under, r)
        parts += [*legs, *mirrored([rod([x, under, -z], [x, under, z], r)])]
        parts.append(rod([-x, under, 0], [x, under, 0], r))
        if high or rng.random() < 0.3:
            parts += rails(rng, x, z, under, spread, 0.7 * r)
        return canonical(parts)
    if kind == "column":
        if high:
            parts.append(tube(ring_path(0.16, 0.3), 0.01))
            parts.append(rod([0, 0.3, -0.16], [0, 0.3, 0.16], 0.01))
        return canonical(parts + column(rng, under, rng.uniform(0.18, 0.25)))
    return canonical(parts + {"sled": sled, "cantilever": cantilever}[kind](rng, x, z, under, r))


def zigzag_chair(rng: Generator) -> trimesh.Trimesh:
    """A chair that is one sheet from its foot plate by a slanting stem to the back's top."""
    width, depth, y = rng.uniform(0.36, 0.52), rng.uniform(0.38, 0.5), rng.uniform(0.40, 0.46)
    t, reach = rng.uniform(0.02, 0.06), rng.uniform(0.28, 0.55)
    front = -depth / 2
    if rng.random() < 0.5:
        low = [[0, t / 2, front], [0, t / 2, -front]]
    else:
        low = [[0, t / 2, -front * 1.1], [0, t / 2, front * rng.uniform(0.2, 1.0)]]
    knots = [*low, [0, y, front], [0, y, -front], [0, y + reach, -front + rng.uniform(0.05, 0.3) * reach]]
    path = smooth_path(knots, rng.uniform(0.03, 0.12), 6)
    waist = np.interp(path[:, 1], [0, y / 2, y], [1.0, rng.uniform(0.75, 1.0), 1.0])
    top = np.interp(path[:, 1], [y + 0.5 * reach, y + reach], [1.0, rng.uniform(0.6, 1.0)])
    return canonical([bent_sheet(path, width * waist * top, t, np.zeros(len(path)))])
