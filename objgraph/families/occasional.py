"""Side, tray, bedside and coffee tables, and consoles with racks."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, mirrored, outline, ring_path, rod, slab, tube
from objgraph.families.supports import corner_legs, sled

Parts = list[trimesh.Trimesh]


def rimmed(rng: Generator, width: float, depth: float, y: float) -> Parts:
    """A top with a raised rim on all sides, on three, or with a gallery behind."""
    t, rim, wall = rng.uniform(0.008, 0.025), rng.uniform(0.02, 0.09), rng.uniform(0.006, 0.02)
    parts = [box([width, t, depth], [0, y - t / 2, 0])]
    parts += mirrored([box([wall, rim, depth], [width / 2 - wall / 2, y + rim / 2 - t / 2, 0])])
    sides = {0: (1,), 1: (-1, 1), 2: (-1, 1)}[int(rng.integers(3))]
    return parts + [
        box([width, rim, wall], [0, y + rim / 2 - t / 2, s * (depth / 2 - wall / 2)]) for s in sides
    ]


def tray_table(rng: Generator) -> trimesh.Trimesh:
    """A thin round or square tray on rods that cross at the floor, stand on rings, or carry a lower shelf."""
    width, y = rng.uniform(0.32, 0.9), rng.uniform(0.35, 0.65)
    t, r, reach = rng.uniform(0.006, 0.02), rng.uniform(0.005, 0.014), width * rng.uniform(0.4, 0.49)
    square = rng.random() < 0.3
    shape = outline(width, width, 20.0) if square else outline(width, width, 2.0, 40)
    parts = [slab(shape, y - t, y)]
    if not square and rng.random() < 0.6:
        parts.append(tube(ring_path(width / 2, y + rng.uniform(0, 0.02)), rng.uniform(0.006, 0.012), 1.5))
    count = int(rng.choice([3, 4, 4]))
    start = np.pi / 4 if square else rng.uniform(0, np.pi)
    angles = start + 2 * np.pi * np.arange(count) / count
    feet = np.stack([np.cos(angles), np.zeros(count), np.sin(angles)], 1) * reach
    if square:
        feet *= 1.35
    parts += [rod(foot + np.array([0, y - t / 2, 0]), foot, r) for foot in feet]
    kind = rng.choice(["cross", "ring", "shelf", "none"])
    if kind == "cross":
        low = rng.choice([r, 0.3 * y])
        parts += [rod([0, low, 0], foot + np.array([0, low, 0]), r) for foot in feet]
    elif kind == "ring" and not square:
        parts += [tube(ring_path(reach, a), r) for a in (r, y - t - r)]
    elif kind == "shelf":
        low = y * rng.uniform(0.15, 0.5)
        parts.append(slab(shape * rng.uniform(0.9, 1.0), low, low + t))
    return canonical(parts)


def rack_console(rng: Generator) -> trimesh.Trimesh:
    """A narrow table or trolley with a rim on top and one or two racks of slats or boards below."""
    y, width, depth = rng.uniform(0.45, 0.95), rng.uniform(0.4, 1.3), rng.uniform(0.22, 0.5)
    depth = min(width, depth)
    parts = rimmed(rng, width, depth, y)
    if rng.random() < 0.4:
        t = rng.uniform(0.012, 0.04)
        parts = [slab(outline(width, depth, float(rng.choice([14.0, 60.0]))), y - t, y)]
    r = rng.uniform(0.008, 0.025)
    x, z = width / 2 - 2 * r, depth / 2 - 2 * r
    legs, _ = corner_legs(rng, x, z, y - 0.005, r, splay=0.0)
    parts += legs
    for share in rng.uniform(0.12, 0.8, int(rng.integers(1, 3))):
        parts += mirrored([rod([x, share * y, -z], [x, share * y, z], 0.7 * r, sections=4)])
        if rng.random() < 0.4:
            parts.append(box([2 * x, 0.015, 2 * z], [0, share * y, 0]))
            continue
        slats = np.linspace(-0.95, 0.95, int(rng.integers(4, 9))) * z
        parts += [rod([-x, share * y, a], [x, share * y, a], rng.uniform(0.3, 0.6) * r) for a in slats]
    if rng.random() < 0.4:
        parts += [rod([-x, 0.9 * y, s * z], [x, 0.9 * y, s * z], 0.8 * r, sections=4) for s in (-1, 1)]
    return canonical(parts)


def carcass(rng: Generator, width: float, depth: float, low: float, high: float) -> Parts:
    """A box of boards, with shelves and uprights; open, closed behind, or with a front on one bay."""
    t = rng.uniform(0.012, 0.04)
    parts = [box([width, t, depth], [0, a, 0]) for a in (low + t / 2, high - t / 2)]
    parts += mirrored([box([t, high - low, depth], [width / 2 - t / 2, (low + high) / 2, 0])])
    for a in rng.uniform(-0.35, 0.35, int(rng.integers(0, 3))) * width:
        parts.append(box([t, high - low, depth * 0.97], [a, (low + high) / 2, 0]))
    if rng.random() < 0.5:
        parts.append(box([width - t, t, depth * 0.97], [0, low + (high - low) * rng.uniform(0.3, 0.7), 0]))
    middle = (low + high) / 2
    if rng.random() < 0.5:
        parts.append(box([width - t, high - low, t], [0, middle, depth / 2 - t * rng.choice([0.5, 6])]))
    if rng.random() < 0.5:
        share = rng.choice([0.33, 0.5, 1.0])
        size = [share * width * 0.99, high - low, depth * 0.97]
        parts.append(box(size, [(share - 1) * width / 2 * rng.choice([-1, 1]) * 0.99, middle, 0]))
    return parts


def box_table(rng: Generator) -> trimesh.Trimesh:
    """A coffee or bedside table that is an open or closed box, on the floor or on legs, or a box under a top."""
    bedside = rng.random() < 0.4
    width = rng.uniform(0.32, 0.6) if bedside else rng.uniform(0.6, 1.4)
    depth = min(width, rng.uniform(0.3, 0.45) if bedside else rng.uniform(0.4, 0.75))
    y = rng.uniform(0.4, 0.7) if bedside else rng.uniform(0.25, 0.5)
    low = rng.choice([0.0, rng.uniform(0.02, 0.1), rng.uniform(0.3, 0.7) * y])
    parts = carcass(rng, width, depth, low, y)
    if low > 0.015:
        r = rng.uniform(0.01, 0.03)
        x, z = width / 2 - 1.3 * r, depth / 2 - 1.3 * r
        if low > 0.12 and rng.random() < 0.25:
            parts += sled(rng, x, z, low + 0.01, 0.6 * r)
        else:
            parts += corner_legs(rng, x, z, low + 0.01, r)[0]
    if rng.random() < 0.3:
        t = rng.uniform(0.015, 0.04)
        parts.append(box([width * rng.uniform(1.0, 1.12), t, depth * 1.05], [0, y + t / 2 - 0.002, 0]))
    return canonical(parts)


def framed_top(rng: Generator) -> trimesh.Trimesh:
    """A plate of glass in or on a thin frame of bars, with a lower shelf of glass or wire; long or square."""
    width, y = rng.uniform(0.4, 1.4), rng.uniform(0.3, 0.75)
    depth = width * rng.uniform(0.4, 1.0)
    r, t = rng.uniform(0.008, 0.022), rng.uniform(0.006, 0.014)
    x, z = width / 2 - r, depth / 2 - r
    levels = [y - r, *(rng.uniform(0.02, 0.7, int(rng.integers(1, 3))) * y)]
    parts = mirrored([rod([x, y, s * z], [x, 0, s * z], r, sections=4) for s in (-1, 1)])
    for level in levels:
        parts += mirrored([rod([x, level, -z], [x, level, z], r, sections=4)])
        parts += [rod([-x, level, s * z], [x, level, s * z], r, sections=4) for s in (-1, 1)]
    for level in (levels[0], levels[-1])[: int(rng.integers(1, 3))]:
        parts.append(box([width - r, t, depth - r], [0, level + r - t / 2, 0]))
    if len(parts) and rng.random() < 0.25:
        parts += mirrored([rod([x, y, s * z], [x, levels[-1], -s * z], 0.6 * r, sections=4) for s in (-1, 1)])
    return canonical(parts)
