"""Tables on four legs, trestles or frames."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, mirrored, outline, rod, slab, smooth_path, tube

Parts = list[trimesh.Trimesh]


def top_plate(rng: Generator, width: float, depth: float, y: float) -> tuple[Parts, float]:
    """A table top and the height of its underside."""
    t = rng.uniform(0.012, 0.06)
    exponent = float(rng.choice([6.0, 12.0, 24.0, 60.0]))
    return [slab(outline(width, depth, exponent, 48), y - t, y, t * rng.uniform(0, 0.4))], y - t


def corners(x: float, z: float) -> list[tuple[float, float]]:
    """The four sign combinations of (x, z)."""
    return [(sx * x, sz * z) for sx in (-1, 1) for sz in (-1, 1)]


def legs_at(rng: Generator, x: float, z: float, y: float, reach_x: float, reach_z: float) -> Parts:
    """Four legs at (+-x, +-z): square or round, tapered or straight, upright or splayed out to the reach."""
    radius = rng.uniform(0.012, 0.055)
    sections = int(rng.choice([4, 4, 12]))
    taper = rng.uniform(0.45, 1.0) if rng.random() < 0.6 else 1.0
    splay = rng.uniform(0, 1) * (rng.random() < 0.35)
    return [
        rod(
            [a, y, b],
            [a + np.sign(a) * splay * reach_x, 0, b + np.sign(b) * splay * reach_z],
            radius,
            radius * taper,
            sections,
        )
        for a, b in corners(x, z)
    ]


def aprons(rng: Generator, x: float, z: float, y: float, share: float) -> Parts:
    """Rails under the top, between the legs."""
    height, t = rng.uniform(0.04, 0.13) * share, rng.uniform(0.012, 0.03)
    parts = [box([2 * x, height, t], [0, y - height / 2, s * z]) for s in (-1, 1)]
    return parts + [box([t, height, 2 * z], [s * x, y - height / 2, 0]) for s in (-1, 1)]


def four_leg_table(rng: Generator, low: bool = False) -> trimesh.Trimesh:
    """A rectangular table: legs at the corners or inset, aprons, shelf or stretchers."""
    if low:
        y, width, depth = rng.uniform(0.25, 0.52), rng.uniform(0.45, 1.4), rng.uniform(0.40, 0.8)
    else:
        y, width, depth = rng.uniform(0.62, 0.80), rng.uniform(0.6, 2.6), rng.uniform(0.5, 1.15)
    width, depth = max(width, depth), min(width, depth)
    parts, under = top_plate(rng, width, depth, y)
    inset = rng.choice([rng.uniform(0.02, 0.06), rng.uniform(0.06, 0.2)], p=[0.7, 0.3])
    x, z = width / 2 - inset, depth / 2 - min(inset, 0.3 * depth)
    parts += legs_at(rng, x, z, under + 0.005, inset, inset)
    if rng.random() < 0.65:
        parts += aprons(rng, x, z, under + 0.002, 0.6 if low else 1.0)
    extra = rng.random()
    if extra < 0.2:
        shelf = y * rng.uniform(0.2, 0.5)
        parts.append(box([2 * x, rng.uniform(0.012, 0.03), 2 * z], [0, shelf, 0]))
    elif extra < 0.35:
        rail, r = y * rng.uniform(0.12, 0.3), rng.uniform(0.01, 0.025)
        parts += [rod([s * x, rail, -z], [s * x, rail, z], r, sections=4) for s in (-1, 1)]
        parts.append(rod([-x, rail, 0], [x, rail, 0], r, sections=4))
    return canonical(parts)


def coffee_table(rng: Generator) -> trimesh.Trimesh:
    """A low table: four legs, a box with open sides, or two waterfall panels."""
    if rng.random() < 0.6:
        return four_leg_table(rng, low=True)
    y, width, depth = rng.uniform(0.28, 0.5), rng.uniform(0.6, 1.4), rng.uniform(0.4, 0.8)
    t = rng.uniform(0.02, 0.06)
    parts = [box([width, t, depth], [0, y - t / 2, 0])]
    parts += mirrored(
        [box([t, y, depth * rng.uniform(0.7, 1.0)], [width / 2 - rng.uniform(0.5, 3) * t, y / 2, 0])]
    )
    if rng.random() < 0.6:
        parts.append(box([width - t, t, depth * 0.9], [0, y * rng.uniform(0.15, 0.5), 0]))
    if rng.random() < 0.25:
        parts.append(box([width - t, y * 0.5, t], [0, y * 0.4, rng.uniform(-0.3, 0.3) * depth]))
    return canonical(parts)


def console_table(rng: Generator) -> trimesh.Trimesh:
    """A narrow side table, perhaps with shelves or drawers, or a small square one."""
    y, width = rng.uniform(0.5, 0.9), rng.uniform(0.35, 1.5)
    depth = min(width, rng.uniform(0.25, 0.5))
    parts, under = top_plate(rng, width, depth, y)
    inset = rng.uniform(0.015, 0.05)
    x, z = width / 2 - inset, depth / 2 - inset
    parts += legs_at(rng, x, z, under + 0.002, inset, inset)
    if rng.random() < 0.5:
        height = rng.uniform(0.08, 0.2)
        parts.append(box([2 * x, height, 2 * z], [0, under - height / 2 + 0.002, 0]))
    for share in rng.uniform(0.1, 0.7, int(rng.integers(0, 3))):
        parts.append(box([2 * x, 0.02, 2 * z], [0, y * share, 0]))
    return canonical(parts)


def trestle_table(rng: Generator) -> trimesh.Trimesh:
    """A long table on two trestles: A or X frames, or posts with a foot, and a beam between them."""
    y, width, depth = rng.uniform(0.68, 0.78), rng.uniform(1.2, 2.6), rng.uniform(0.6, 1.1)
    parts, under = top_plate(rng, width, depth, y)
    x, z, r = width / 2 * rng.uniform(0.55, 0.9), depth / 2 * rng.uniform(0.7, 0.95), rng.uniform(0.02, 0.05)
    kind = rng.choice(["a", "x", "post"])
    for side in (-x, x):
        if kind == "a":
            parts += [
                rod([side, under + 0.002, s * z * 0.3], [side, 0, s * z], r, sections=4) for s in (-1, 1)
            ]
            parts.append(rod([side, y * 0.4, -z * 0.7], [side, y * 0.4, z * 0.7], 0.6 * r, sections=4))
        elif kind == "x":
            parts += [rod([side, under + 0.002, -s * z], [side, 0, s * z], r, sections=4) for s in (-1, 1)]
        else:
            parts.append(box([2 * r, under, rng.uniform(0.1, 0.9) * z], [side, under / 2, 0]))
            parts.append(box([2.5 * r, 1.6 * r, 2 * z], [side, 0.8 * r, 0]))
        parts.append(box([2 * r, 0.05, 1.8 * z], [side, under - 0.023, 0]))
    if rng.random() < 0.7:
        beam = y * rng.uniform(0.15, 0.5)
        parts.append(box([2 * x, rng.uniform(0.04, 0.1), 1.4 * r], [0, beam, 0]))
    return canonical(parts)


def frame_table(rng: Generator) -> trimesh.Trimesh:
    """A top on bent-tube or square sledge frames, or on hairpin legs."""
    low = rng.random() < 0.3
    y = rng.uniform(0.35, 0.5) if low else rng.uniform(0.68, 0.78)
    width, depth = (
        rng.uniform(0.8, 2.2) * (0.6 if low else 1.0),
        rng.uniform(0.5, 1.0) * (0.8 if low else 1.0),
    )
    parts, under = top_plate(rng, width, depth, y)
    x, z, r = (
        width / 2 * rng.uniform(0.6, 0.95),
        depth / 2 * rng.uniform(0.7, 0.95),
        rng.uniform(0.012, 0.035),
    )
    sections, bend = int(rng.choice([4, 12])), rng.uniform(0.01, 0.08)
    for side in (-x, x):
        feet = rng.uniform(0.5, 1.0) * z
        knots = [
            [side, under, 0],
            [side, under - r, -z],
            [side, r, -feet],
            [side, r, feet],
            [side, under - r, z],
            [side, under, 0],
        ]
        parts.append(tube(smooth_path(knots, bend), r, sections=sections))
    if rng.random() < 0.5:
        parts += [
            rod([-x, under - r, s * z * 0.9], [x, under - r, s * z * 0.9], r, sections=sections)
            for s in (-1, 1)
        ]
    return canonical(parts)
