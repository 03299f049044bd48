"""Desks; the sitter is at -z."""

import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, mirrored, rod
from objgraph.families.tables import top_plate

Parts = list[trimesh.Trimesh]


def desk(rng: Generator) -> trimesh.Trimesh:
    """A desk: legs, side panels or drawer pedestals, perhaps a modesty panel behind; the sitter at -z."""
    y, width, depth = rng.uniform(0.70, 0.79), rng.uniform(0.9, 2.0), rng.uniform(0.48, 0.9)
    parts, under = top_plate(rng, width, depth, y)
    t = rng.uniform(0.016, 0.035)
    x, z = width / 2 - rng.uniform(0.02, 0.08), depth / 2 - rng.uniform(0.02, 0.08)
    for side in (-1, 1):
        parts += desk_side(rng, side, x, z, under, t)
    if rng.random() < 0.55:
        height = rng.uniform(0.15, 0.95) * under
        parts.append(box([2 * x, height, t], [0, under - height / 2 + 0.002, z * rng.uniform(0.5, 1.0)]))
    if rng.random() < 0.25:
        parts.append(box([2 * x, 0.1, 1.6 * z], [0, under - 0.048, 0]))
    if rng.random() < 0.2:
        parts += hutch(rng, width, depth, y)
    if rng.random() < 0.12:
        parts += return_wing(rng, width, depth, (under, y), t)
    return canonical(parts)


def desk_side(rng: Generator, side: int, x: float, z: float, under: float, t: float) -> Parts:
    """What carries one end of a desk: drawers, a panel, two legs, or a T frame."""
    kind = rng.choice(["drawers", "panel", "legs", "frame"], p=[0.35, 0.25, 0.2, 0.2])
    if kind == "drawers":
        wide = rng.uniform(0.3, 0.45)
        foot = rng.uniform(0.0, 0.35) * (rng.random() < 0.7)
        parts = drawers(rng, wide, 1.7 * z, side * (x - wide / 2), under + 0.002, foot)
        legs = (-1, 1) if foot > 0.12 else ()
        return parts + [
            rod([side * x, foot + 0.3, s * z], [side * x, 0, s * z], 0.02, sections=4) for s in legs
        ]
    if kind == "panel":
        return [box([t, under + 0.004, 2 * z], [side * x, under / 2, 0])]
    if kind == "legs":
        r = rng.uniform(0.015, 0.03)
        return [rod([side * x, under + 0.002, s * z], [side * x, 0, s * z], r) for s in (-1, 1)]
    r = rng.uniform(0.02, 0.035)
    return [
        rod([side * x, under + 0.002, 0], [side * x, r, 0], r, sections=4),
        rod([side * x, r, -z], [side * x, r, z], r, sections=4),
        rod([side * x, under - r, -0.8 * z], [side * x, under - r, 0.8 * z], r, sections=4),
    ]


def drawers(rng: Generator, width: float, depth: float, x: float, y: float, foot: float) -> Parts:
    """A pedestal of drawers hung at x under height y, its fronts and knobs towards -z."""
    height = y - foot
    parts = [box([width, height, depth], [x, foot + height / 2, 0])]
    count = int(rng.integers(1, 5))
    for i in range(count):
        middle = foot + height * (i + 0.5) / count
        parts.append(box([width * 0.94, height / count * 0.9, 0.02], [x, middle, -depth / 2 - 0.008]))
        parts.append(box([min(0.12, width * 0.4), 0.015, 0.025], [x, middle, -depth / 2 - 0.028]))
    return parts


def hutch(rng: Generator, width: float, depth: float, y: float) -> Parts:
    """A low shelf or screen on the back of a desk."""
    height, reach, t = rng.uniform(0.1, 0.4), rng.uniform(0.15, 0.28), 0.02
    back = [box([width * 0.96, height, t], [0, y + height / 2 - 0.002, depth / 2 - t])]
    if rng.random() < 0.5:
        return back
    shelf = box([width * 0.96, t, reach], [0, y + height, depth / 2 - reach / 2])
    return [
        *back,
        shelf,
        *mirrored(
            [box([t, height, reach], [width * 0.48 - t / 2, y + height / 2 - 0.002, depth / 2 - reach / 2])]
        ),
    ]


def return_wing(rng: Generator, width: float, depth: float, top: tuple[float, float], t: float) -> Parts:
    """The shorter arm of an L, towards the sitter; `top` holds the heights of the plate's two faces."""
    under, y = top
    wing, x = rng.uniform(0.5, 0.9), -width / 2
    plate = [depth * 0.7, y - under, wing]
    leg = [x + depth * 0.6, under, -depth / 2 - wing + 0.05]
    return [
        box(plate, [x + depth * 0.35, (y + under) / 2, -depth / 2 - wing / 2 + 0.01]),
        box([t, under + 0.004, wing * 0.8], [x + 0.05, under / 2, -depth / 2 - wing / 2]),
        rod(leg, [leg[0], 0, leg[2]], 0.02),
    ]
