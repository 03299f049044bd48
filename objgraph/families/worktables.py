"""Desks with boxes, towers and corners; tables on end frames, turned trestles and cross legs. The sitter is at -z."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.desks import drawers
from objgraph.families.occasional import rimmed
from objgraph.families.parts import box, canonical, lathe, mirrored, rod
from objgraph.families.supports import corner_legs, floor_reach, plate, rails

Parts = list[trimesh.Trimesh]


def writing_desk(rng: Generator) -> trimesh.Trimesh:
    """A top on four legs with shallow boxes hung under it on one or both sides, or a row of drawers."""
    y, width, depth = rng.uniform(0.68, 0.8), rng.uniform(0.7, 1.6), rng.uniform(0.42, 0.75)
    parts, under = plate(rng, width, depth, y)
    if rng.random() < 0.2:
        parts, under = rimmed(rng, width, depth, y), y - 0.01
    r = rng.uniform(0.012, 0.032)
    x, z = width / 2 - 1.5 * r, depth / 2 - 1.5 * r
    legs, spread = corner_legs(rng, x, z, under + 0.003, r)
    parts += legs
    kind = rng.choice(["one", "both", "row", "apron"])
    height = rng.uniform(0.08, 0.35)
    if kind == "row":
        parts += drawers(rng, 2 * x, 2 * z, 0.0, under + 0.002, under - rng.uniform(0.06, 0.15))
    elif kind == "apron":
        parts.append(box([2 * x, rng.uniform(0.04, 0.1), 2 * z], [0, under - 0.02, 0]))
    else:
        wide = width * rng.uniform(0.2, 0.34)
        for side in (-1, 1)[: 1 + (kind == "both")]:
            parts += drawers(rng, wide, 1.95 * z, side * (x - wide / 2), under + 0.002, under - height)
    if rng.random() < 0.35:
        parts += rails(rng, x, z, under, spread, 0.6 * r)
    return canonical(parts)


def box_desk(rng: Generator) -> trimesh.Trimesh:
    """A kneehole desk: closed boxes on one or both sides, a closed back, perhaps a corner's second arm."""
    y, width, depth = rng.uniform(0.66, 0.82), rng.uniform(0.9, 1.8), rng.uniform(0.5, 0.85)
    t = rng.uniform(0.02, 0.08)
    foot = rng.uniform(0.0, 0.12) * (rng.random() < 0.6)
    parts = [box([width, t, depth], [0, y - t / 2, 0])]
    inner, z = width / 2 - rng.uniform(0.0, 0.05), depth / 2 - rng.uniform(0.0, 0.05)
    wide, height = rng.uniform(0.2, 0.36) * width, y - t + 0.004 - foot
    both = rng.random() < 0.4
    for side in (-1, 1)[: 1 + both]:
        parts.append(box([wide, height, 2 * z], [side * (inner - wide / 2), foot + height / 2, 0]))
        if rng.random() < 0.5:
            parts += drawers(rng, wide, 2 * z, side * (inner - wide / 2), y - t, foot)
    if not both:
        parts.append(box([0.04, y - t + 0.004, 2 * z], [inner - 0.02, (y - t) / 2, 0]))
    if rng.random() < 0.65:
        low = rng.uniform(0, 0.6) * y
        parts.append(box([2 * inner, y - t - low, 0.03], [0, (y - t + low) / 2, z - 0.02]))
    if foot:
        parts += corner_legs(rng, inner - 0.04, z - 0.04, foot + 0.01, rng.uniform(0.015, 0.035), True, 0.0)[
            0
        ]
    if rng.random() < 0.35:
        wing, arm = rng.uniform(0.3, 0.8), depth * rng.uniform(0.6, 1.0)
        middle = -depth / 2 - wing / 2 + 0.01
        parts.append(box([arm, t, wing], [-width / 2 + arm / 2, y - t / 2, middle]))
        parts.append(
            box([arm * 0.95, height, wing], [-width / 2 + arm / 2, foot + height / 2, middle + 0.02])
        )
    return canonical(parts)


def tower_desk(rng: Generator) -> trimesh.Trimesh:
    """A desk with a shelf tower or cupboard at one end, or with shelves above its rear edge."""
    y, width, depth, t = (
        rng.uniform(0.7, 0.78),
        rng.uniform(0.9, 1.5),
        rng.uniform(0.45, 0.7),
        rng.uniform(0.018, 0.04),
    )
    side = rng.choice([-1, 1])
    wide, tall, deep = rng.uniform(0.3, 0.45), rng.uniform(0.9, 1.5), depth * rng.uniform(0.5, 1.0)
    parts = [box([width, t, depth], [0, y - t / 2, 0])]
    end, z = side * (width / 2 + wide / 2 - 0.01), depth / 2 - deep / 2
    parts.append(box([t, y - 0.002, depth * 0.95], [-side * (width / 2 - rng.uniform(0.02, 0.1)), y / 2, 0]))
    parts += [box([t, tall, deep], [end + s * (wide / 2 - t / 2), tall / 2, z]) for s in (-1, 1)]
    for height in np.linspace(t / 2, tall - t / 2, int(rng.integers(3, 6))):
        parts.append(box([wide, t, deep * 0.98], [end, height, z]))
    if rng.random() < 0.5:
        parts.append(box([wide, tall, 0.015], [end, tall / 2, depth / 2 - 0.01]))
    if rng.random() < 0.5:
        parts.append(box([width, rng.uniform(0.1, 0.5), t], [0, y - 0.2, depth / 2 - 0.05]))
    return canonical(parts)


def end_frame_table(rng: Generator) -> trimesh.Trimesh:
    """A top on two end frames with rails, or on leaning pairs of legs tied at one height."""
    low = rng.random() < 0.25
    y = rng.uniform(0.35, 0.5) if low else rng.uniform(0.6, 1.0)
    width, depth = rng.uniform(0.6, 1.8), rng.uniform(0.45, 0.85)
    depth = min(width, depth)
    parts, under = plate(rng, width, depth, y)
    r, kind = rng.uniform(0.014, 0.045), rng.integers(3)
    x, z = width / 2 * rng.uniform(0.7, 0.97) - r, depth / 2 * rng.uniform(0.6, 0.98) - r
    legs, spread = corner_legs(rng, x, z, under + 0.003, r)
    parts += legs
    for share in rng.uniform(0.03, 0.9, int(rng.integers(1, 3))):
        a, b = floor_reach(x, z, spread, share)
        level = under * (1 - share)
        size = [r, rng.uniform(0.02, 0.09), 2 * b]
        parts += mirrored([box(size, [a, level, 0])])
        if kind == 0:
            parts.append(box([2 * a, size[1], r], [0, level, rng.choice([0.0, b])]))
    if kind == 1:
        parts.append(
            box([2 * x, rng.uniform(0.04, 0.1), 0.02], [0, under - 0.02, z * rng.choice([-1, 0, 1])])
        )
    return canonical(parts)


def turned_trestle(rng: Generator) -> trimesh.Trimesh:
    """A long top on two turned or square posts with shaped feet, joined by a low beam."""
    y, width, depth = rng.uniform(0.45, 0.8), rng.uniform(1.1, 2.4), rng.uniform(0.6, 1.0)
    parts, under = plate(rng, width, depth, y)
    x, z, r = width * rng.uniform(0.25, 0.44), depth * rng.uniform(0.32, 0.46), rng.uniform(0.03, 0.07)
    heights = np.linspace(0.1 * y, 0.93 * y, 7)
    radii = r * rng.uniform(0.6, 1.5, 7)
    square = rng.random() < 0.35
    foot = rng.uniform(0.6, 1.2) * r
    for side in (-x, x):
        if square:
            parts.append(rod([side, under, 0], [side, 0.03, 0], r, r * rng.uniform(0.6, 1.2), 4))
        else:
            profile = [(float(a), float(min(b, under))) for a, b in zip(radii, heights, strict=True)]
            parts.append(lathe([(r, 0.02), *profile], x=side))
        for s in (-1, 1):
            parts.append(rod([side, 0.1 * y + foot, 0], [side, 0.6 * foot, s * z], foot, 0.6 * foot, 4))
            parts.append(
                rod(
                    [side, under - 0.8 * foot, 0],
                    [side, under - 0.5 * foot, s * 0.8 * z],
                    0.8 * foot,
                    0.5 * foot,
                    4,
                )
            )
    level = rng.uniform(0.08, 0.5) * y
    if rng.random() < 0.85:
        parts.append(rod([-x, level, 0], [x, level, 0], rng.uniform(0.4, 0.8) * r, sections=4))
    return canonical(parts)


def cross_leg_table(rng: Generator) -> trimesh.Trimesh:
    """A small or long table whose legs cross in pairs, seen from the front or from the end."""
    y, width = rng.uniform(0.4, 0.78), rng.uniform(0.4, 1.8)
    depth = min(width, rng.uniform(0.35, 0.85))
    parts, under = plate(rng, width, depth, y)
    r, sections = rng.uniform(0.01, 0.035), int(rng.choice([4, 12]))
    start = under - 0.5 * r
    x, z = width / 2 * rng.uniform(0.6, 0.92), depth / 2 * rng.uniform(0.6, 0.92)
    front = width < 1.1 and rng.random() < 0.5
    for s in (-1, 1):
        for side in (-1, 1):
            top, foot = [side * x, start, s * z], [-side * x, 0, s * z]
            if not front:
                top, foot = [s * x, start, side * z], [s * x, 0, -side * z]
            parts.append(rod(top, foot, r, sections=sections))
    middle = under / 2
    ends = ([0, middle, -z], [0, middle, z]) if front else ([-x, middle, 0], [x, middle, 0])
    parts.append(rod(*ends, rng.uniform(0.5, 1.0) * r, sections=sections))
    if rng.random() < 0.4:
        parts.append(box([2 * x, 0.05, 0.02], [0, under - 0.02, rng.choice([-1, 1]) * z]))
    return canonical(parts)
