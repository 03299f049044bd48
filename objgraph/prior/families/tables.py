"""Tables on four legs or on panels: dining, coffee, desks, consoles, trestles, conference tables."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.prior.families.parts import box, canonical, mirrored, outline, rod, slab, smooth_path, tube

Parts = list[trimesh.Trimesh]


def corners(x: float, z: float) -> list[tuple[float, float]]:
    """The four sign combinations of (x, z)."""
    return [(sx * x, sz * z) for sx in (-1, 1) for sz in (-1, 1)]


def top_plate(rng: Generator, width: float, depth: float, y: float) -> tuple[Parts, float]:
    """A table top and the height of its underside."""
    t = rng.uniform(0.012, 0.06)
    exponent = float(rng.choice([6.0, 12.0, 24.0, 60.0]))
    return [slab(outline(width, depth, exponent, 48), y - t, y, t * rng.uniform(0, 0.4))], y - t


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


def desk(rng: Generator) -> trimesh.Trimesh:
    """A desk: legs, side panels or drawer pedestals, perhaps a modesty panel behind; the sitter at -z."""
    y, width, depth = rng.uniform(0.70, 0.79), rng.uniform(0.9, 2.0), rng.uniform(0.48, 0.9)
    parts, under = top_plate(rng, width, depth, y)
    t = rng.uniform(0.016, 0.035)
    x, z = width / 2 - rng.uniform(0.02, 0.08), depth / 2 - rng.uniform(0.02, 0.08)
    for side in (-1, 1):
        kind = rng.choice(["drawers", "panel", "legs", "frame"], p=[0.35, 0.25, 0.2, 0.2])
        if kind == "drawers":
            wide = rng.uniform(0.3, 0.45)
            foot = rng.uniform(0.0, 0.35) * (rng.random() < 0.7)
            parts += drawers(rng, wide, 1.7 * z, side * (x - wide / 2), under + 0.002, foot)
            if foot > 0.12:
                parts += [
                    rod([side * x, foot + 0.3, s * z], [side * x, 0, s * z], 0.02, sections=4)
                    for s in (-1, 1)
                ]
        elif kind == "panel":
            parts.append(box([t, under + 0.004, 2 * z], [side * x, under / 2, 0]))
        elif kind == "legs":
            r = rng.uniform(0.015, 0.03)
            parts += [rod([side * x, under + 0.002, s * z], [side * x, 0, s * z], r) for s in (-1, 1)]
        else:
            r = rng.uniform(0.02, 0.035)
            parts.append(rod([side * x, under + 0.002, 0], [side * x, r, 0], r, sections=4))
            parts.append(rod([side * x, r, -z], [side * x, r, z], r, sections=4))
            parts.append(rod([side * x, under - r, -0.8 * z], [side * x, under - r, 0.8 * z], r, sections=4))
    if rng.random() < 0.55:
        height = rng.uniform(0.15, 0.95) * under
        parts.append(box([2 * x, height, t], [0, under - height / 2 + 0.002, z * rng.uniform(0.5, 1.0)]))
    if rng.random() < 0.25:
        parts.append(box([2 * x, 0.1, 1.6 * z], [0, under - 0.048, 0]))
    if rng.random() < 0.2:
        parts += hutch(rng, width, depth, y)
    if rng.random() < 0.12:
        wing = rng.uniform(0.5, 0.9)
        parts.append(
            box(
                [depth * 0.7, y - under, wing],
                [-width / 2 + depth * 0.35, (y + under) / 2, -depth / 2 - wing / 2 + 0.01],
            )
        )
        parts.append(
            box([t, under + 0.004, wing * 0.8], [-width / 2 + 0.05, under / 2, -depth / 2 - wing / 2])
        )
        parts.append(
            rod(
                [-width / 2 + depth * 0.6, under, -depth / 2 - wing + 0.05],
                [-width / 2 + depth * 0.6, 0, -depth / 2 - wing + 0.05],
                0.02,
            )
        )
    return canonical(parts)


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


def boat(width: float, depth: float, swell: float) -> np.ndarray:
    """The outline of a conference table: ends narrower by `swell`, long sides bowed."""
    u = np.linspace(-1, 1, 25)
    z = depth / 2 * (1 - swell * u**2)
    upper = np.stack([u * width / 2, z], 1)
    return np.concatenate([upper, upper[::-1] * [1, -1]])[::-1]


def conference_table(rng: Generator) -> trimesh.Trimesh:
    """A large meeting table: rectangular, boat, racetrack or oval, on panels, drums, or rows of legs."""
    y, width = rng.uniform(0.70, 0.77), rng.uniform(1.6, 4.2)
    depth = rng.uniform(0.75, 1.6)
    t = rng.uniform(0.02, 0.07)
    kind = rng.choice(["rectangle", "boat", "race", "oval"], p=[0.45, 0.25, 0.2, 0.1])
    shapes = {
        "rectangle": lambda: outline(width, depth, 60.0, 48),
        "boat": lambda: boat(width, depth, rng.uniform(0.1, 0.35)),
        "race": lambda: outline(width, depth, rng.uniform(3, 8), 48),
        "oval": lambda: outline(width, depth, 2.2, 48),
    }
    under = y - t
    parts = [slab(shapes[kind](), under, y, t * rng.uniform(0, 0.4))]
    x = width / 2 * rng.uniform(0.5, 0.85)
    z = depth / 2 * rng.uniform(0.35, 0.8)
    base = rng.choice(["panels", "drums", "tees", "legs", "shelled"], p=[0.25, 0.15, 0.25, 0.25, 0.1])
    panel_t = rng.uniform(0.02, 0.09)
    if base == "legs":
        r = rng.uniform(0.018, 0.045)
        rows = np.linspace(-x, x, 2 if width < 2.6 else 3)
        parts += [
            rod([a, under + 0.002, s * z], [a, 0, s * z], r, sections=int(rng.choice([4, 12])))
            for a in rows
            for s in (-1, 1)
        ]
        parts += aprons(rng, x, z, under + 0.002, 0.7)
    elif base == "shelled":
        parts += [box([2 * x, under, panel_t], [0, under / 2, s * z]) for s in (-1, 1)]
        parts += [box([panel_t, under, 2 * z], [s * x, under / 2, 0]) for s in (-1, 1)]
    for side in (-x, x):
        if base == "panels":
            parts.append(box([panel_t, under + 0.004, 2 * z], [side, under / 2, 0]))
        elif base == "drums":
            drum = slab(outline(rng.uniform(0.25, 0.6), 1.6 * z, rng.choice([2.0, 20.0])), 0, under + 0.002)
            drum.apply_translation([side, 0, 0])
            parts.append(drum)
        elif base == "tees":
            r = rng.uniform(0.03, 0.06)
            parts.append(rod([side, under + 0.002, 0], [side, 0.03, 0], r, sections=int(rng.choice([4, 12]))))
            parts.append(rod([side, r / 2, -z], [side, r / 2, z], r / 2, sections=4))
            parts.append(box([2 * r, 0.03, 1.6 * z], [side, under - 0.01, 0]))
    if base in ("panels", "tees") and rng.random() < 0.6:
        height = rng.uniform(0.05, 0.5)
        parts.append(box([2 * x, height, 0.02], [0, under - height / 2 + 0.002, 0]))
    return canonical(parts)
