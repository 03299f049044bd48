"""Round and oval tables, and tables on one foot."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, lathe, outline, rod, slab, tube

Parts = list[trimesh.Trimesh]


def round_top(
    rng: Generator, y: float, width: float, depth: float, exponent: float = 2.0
) -> tuple[Parts, float]:
    """A round, oval or softly square top and the height of its underside."""
    t = rng.uniform(0.012, 0.06)
    return [slab(outline(width, depth, exponent, 40), y - t, y, t * rng.uniform(0, 0.45))], y - t


def _size(rng: Generator) -> tuple[float, float, float, float]:
    """Height, width, depth and the outline's exponent."""
    y = rng.choice(
        [rng.uniform(0.68, 0.78), rng.uniform(0.35, 0.6), rng.uniform(0.95, 1.1)], p=[0.65, 0.25, 0.1]
    )
    width = rng.uniform(0.45, 1.5) if y < 0.9 else rng.uniform(0.5, 0.8)
    depth = width * (1.0 if rng.random() < 0.7 else rng.uniform(0.55, 0.9))
    exponent = 2.0 if rng.random() < 0.75 else float(rng.choice([4.0, 20.0]))
    return y, width, depth, exponent


def pedestal_table(rng: Generator) -> trimesh.Trimesh:
    """One column with a disc, a tulip foot, a turned foot with three or four claws, or a flat cross."""
    y, width, depth, exponent = _size(rng)
    parts, under = round_top(rng, y, width, depth, exponent)
    foot, r = width * rng.uniform(0.22, 0.42), rng.uniform(0.02, 0.07)
    kind = rng.choice(["disc", "tulip", "claws", "cross"])
    if kind == "disc":
        parts.append(lathe([(foot, 0), (foot, 0.015), (foot * 0.9, 0.03), (r, 0.04), (r, under + 0.002)]))
    elif kind == "tulip":
        v = np.linspace(0, 1, 10)
        radii = r + (foot - r) * np.exp(-v / rng.uniform(0.03, 0.15)) + 1.5 * r * np.clip(v - 0.8, 0, 1)
        parts.append(lathe([(a, 0.01 + b * (under - 0.008)) for a, b in zip(radii, v, strict=True)]))
    else:
        arms = int(rng.integers(3, 6)) if kind == "claws" else 4
        rise = rng.uniform(0.1, 0.35) * y if kind == "claws" else 0.03
        turn = rng.choice([0.0, np.pi / 4])
        for angle in turn + 2 * np.pi * np.arange(arms) / arms:
            out = np.array([np.cos(angle), 0.0, np.sin(angle)])
            middle = 0.5 * foot * out + [0, rise * 0.75, 0]
            parts.append(
                tube([[0, rise, 0], middle, foot * 1.1 * out + [0, 0.02, 0]], [0.8 * r, 0.6 * r, 0.02])
            )
        swell = r * rng.uniform(1.0, 1.8)
        parts.append(
            lathe([(r, rise * 0.5), (swell, under * 0.45), (r, under * 0.8), (1.3 * r, under + 0.002)])
        )
        if rng.random() < 0.4:
            parts.append(box([width * 0.5, 0.02, 0.06], [0, under - 0.008, 0]))
    return canonical(parts)


def round_leg_table(rng: Generator) -> trimesh.Trimesh:
    """Three to five legs under a round or oval top, upright or splayed, with or without an apron or ring."""
    y, width, depth, exponent = _size(rng)
    parts, under = round_top(rng, y, width, depth, exponent)
    legs = int(rng.choice([3, 4, 4, 4, 5]))
    inset, spread, r = rng.uniform(0.45, 0.85), rng.uniform(0.9, 1.4), rng.uniform(0.012, 0.045)
    sections = int(rng.choice([4, 12]))
    for angle in 2 * np.pi * (np.arange(legs) + 0.5) / legs:
        out = np.array([np.cos(angle) * width / 2, 0.0, np.sin(angle) * depth / 2]) * inset
        parts.append(
            rod(
                out + np.array([0, under + 0.002, 0]),
                out * min(spread, 0.97 / inset),
                r,
                r * rng.uniform(0.5, 1),
                sections,
            )
        )
    if rng.random() < 0.4:
        height = rng.uniform(0.03, 0.09)
        parts.append(slab(outline(width * inset, depth * inset, 2.0), under - height, under + 0.002))
    if rng.random() < 0.25:
        parts.append(slab(outline(width * inset, depth * inset, 2.0), y * 0.3, y * 0.3 + 0.02))
    return canonical(parts)


def cross_base_table(rng: Generator) -> trimesh.Trimesh:
    """A top on crossing panels, or on crossing slanted legs that meet in the middle."""
    y, width, depth, exponent = _size(rng)
    parts, under = round_top(rng, y, width, depth, exponent)
    reach_x, reach_z = width * rng.uniform(0.28, 0.45), depth * rng.uniform(0.28, 0.45)
    if rng.random() < 0.4:
        t = rng.uniform(0.02, 0.06)
        parts += [
            box([2 * reach_x, under + 0.004, t], [0, under / 2, 0]),
            box([t, under + 0.004, 2 * reach_z], [0, under / 2, 0]),
        ]
    else:
        r = rng.uniform(0.015, 0.04)
        for sx in (-1, 1):
            for sz in (-1, 1):
                parts.append(
                    rod(
                        [-sx * reach_x * 0.8, under + 0.002, -sz * reach_z * 0.8],
                        [sx * reach_x, 0, sz * reach_z],
                        r,
                    )
                )
    return canonical(parts)


def drum_table(rng: Generator) -> trimesh.Trimesh:
    """A closed or open drum or block: a side table without legs."""
    y, width = rng.uniform(0.3, 0.6), rng.uniform(0.35, 0.8)
    depth = width * rng.uniform(0.7, 1.0)
    exponent = float(rng.choice([2.0, 4.0, 20.0]))
    parts, under = round_top(rng, y, width, depth, exponent)
    waist = rng.uniform(0.5, 0.98)
    parts.append(
        slab(outline(width * waist, depth * waist, exponent, 40), 0, under + 0.002, rng.uniform(0, 0.02))
    )
    return canonical(parts)


def double_pedestal_table(rng: Generator) -> trimesh.Trimesh:
    """A long dining or meeting table on two columns, each with a disc or a cross of feet."""
    y, width, depth = rng.uniform(0.70, 0.77), rng.uniform(1.5, 3.2), rng.uniform(0.75, 1.3)
    parts, under = round_top(rng, y, width, depth, float(rng.choice([2.2, 4.0, 12.0, 60.0])))
    x, foot, r = width * rng.uniform(0.22, 0.34), depth * rng.uniform(0.28, 0.42), rng.uniform(0.03, 0.08)
    disc = rng.random() < 0.45
    for side in (-x, x):
        parts.append(lathe([(r, 0.01), (r, under + 0.002)], x=side))
        if disc:
            parts.append(lathe([(foot, 0), (foot * 0.95, 0.025)], x=side))
        else:
            for angle in np.pi / 4 + np.pi / 2 * np.arange(4):
                tip = [side + foot * np.cos(angle), 0.015, foot * np.sin(angle)]
                parts.append(rod([side, 0.06, 0], tip, 0.03, 0.015, sections=4))
        parts.append(box([0.1, 0.03, depth * 0.6], [side, under - 0.012, 0]))
    return canonical(parts)
