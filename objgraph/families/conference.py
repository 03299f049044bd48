"""Large meeting tables."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, outline, rod, slab
from objgraph.families.tables import aprons

Parts = list[trimesh.Trimesh]


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
        parts += rows_of_legs(rng, width, x, z, under)
    elif base == "shelled":
        parts += [box([2 * x, under, panel_t], [0, under / 2, s * z]) for s in (-1, 1)]
        parts += [box([panel_t, under, 2 * z], [s * x, under / 2, 0]) for s in (-1, 1)]
    for side in (-x, x):
        parts += conference_foot(rng, base, side, z, under, panel_t)
    if base in ("panels", "tees") and rng.random() < 0.6:
        height = rng.uniform(0.05, 0.5)
        parts.append(box([2 * x, height, 0.02], [0, under - height / 2 + 0.002, 0]))
    return canonical(parts)


def rows_of_legs(rng: Generator, width: float, x: float, z: float, under: float) -> Parts:
    """Two or three pairs of legs and the rails between them."""
    r = rng.uniform(0.018, 0.045)
    parts = [
        rod([a, under + 0.002, s * z], [a, 0, s * z], r, sections=int(rng.choice([4, 12])))
        for a in np.linspace(-x, x, 2 if width < 2.6 else 3)
        for s in (-1, 1)
    ]
    return parts + aprons(rng, x, z, under + 0.002, 0.7)


def conference_foot(rng: Generator, base: str, x: float, z: float, under: float, thickness: float) -> Parts:
    """One of the two feet at x: a panel, a drum, or a T; none for other bases."""
    if base == "panels":
        return [box([thickness, under + 0.004, 2 * z], [x, under / 2, 0])]
    if base == "drums":
        drum = slab(outline(rng.uniform(0.25, 0.6), 1.6 * z, rng.choice([2.0, 20.0])), 0, under + 0.002)
        drum.apply_translation([x, 0, 0])
        return [drum]
    if base == "tees":
        r = rng.uniform(0.03, 0.06)
        return [
            rod([x, under + 0.002, 0], [x, 0.03, 0], r, sections=int(rng.choice([4, 12]))),
            rod([x, r / 2, -z], [x, r / 2, z], r / 2, sections=4),
            box([2 * r, 0.03, 1.6 * z], [x, under - 0.01, 0]),
        ]
    return []
