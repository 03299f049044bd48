"""Chairs on one foot or on bent tubes: pedestal, cantilever, lounge, folding."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.armrests import armrests
from objgraph.families.backs import backrest
from objgraph.families.parts import (
    box,
    canonical,
    lathe,
    mirrored,
    outline,
    panel,
    rod,
    slab,
    smooth_path,
    tube,
)

Parts = list[trimesh.Trimesh]


def pedestal_chair(rng: Generator) -> trimesh.Trimesh:
    """A shell or padded seat on a column with a round foot, a cross, or a tulip foot."""
    width, depth = rng.uniform(0.42, 0.70), rng.uniform(0.42, 0.62)
    y, t = rng.uniform(0.38, 0.48), rng.uniform(0.02, 0.12)
    parts = [slab(outline(width, depth, rng.uniform(2.2, 5)), y - t, y, 0.4 * t, rng.uniform(0, 0.03))]
    foot, r = rng.uniform(0.2, 0.28), rng.uniform(0.018, 0.05)
    if rng.random() < 0.6:
        heights = np.linspace(0.02, y - t, 7)
        flare = np.exp(-heights / rng.uniform(0.01, 0.08))
        parts.append(
            lathe([(foot, 0.0), *[(r + (foot - r) * f, h) for f, h in zip(flare, heights, strict=True)]])
        )
    else:
        turn = rng.choice([0.0, np.pi / 4])
        for angle in turn + np.pi / 2 * np.arange(4):
            tip = [foot * np.cos(angle), 0.012, foot * np.sin(angle)]
            parts.append(rod([0, 0.05, 0], tip, 0.018, 0.012))
        parts.append(lathe([(r, 0.03), (r, y - t)]))
    parts += backrest_shell(rng, width, y, depth)
    if rng.random() < 0.35:
        parts += armrests(rng, width, depth, y, depth / 2)
    return canonical(parts)


def backrest_shell(rng: Generator, width: float, y: float, depth: float) -> Parts:
    """A curved shell back that wraps round the seat."""
    v = np.linspace(0, 1, 8)
    reach = rng.uniform(0.3, 0.65)
    widths = width * np.interp(v, [0, 0.4, 1], [0.9, 1.0, rng.uniform(0.6, 1.0)])
    depths = depth / 2 - 0.03 + rng.uniform(0.1, 0.35) * reach * v
    return [panel(widths, y - 0.03 + reach * v, depths, rng.uniform(0.015, 0.08), rng.uniform(0.02, 0.18))]


def cantilever_chair(rng: Generator) -> trimesh.Trimesh:
    """Two bent side tubes without rear legs (or a sled's closed sides), a seat and a back."""
    width, depth = rng.uniform(0.42, 0.58), rng.uniform(0.42, 0.55)
    y, reach, r = rng.uniform(0.41, 0.47), rng.uniform(0.32, 0.58), rng.uniform(0.010, 0.017)
    x, z, slope = width / 2, depth / 2, rng.uniform(0.08, 0.25)
    bend = rng.uniform(0.04, 0.12)
    crest = [x, y + reach, z + slope * reach]
    z_floor = z * rng.uniform(0.6, 1.2)
    sled = rng.random() < 0.3
    knots = [crest, [x, y, z], [x, y, -z], [x, r, -z], [x, r, z_floor]]
    if sled:
        knots.append([x, y - 0.01, z * 0.8])
    parts = mirrored([tube(smooth_path(knots, bend), r)])
    if not sled or rng.random() < 0.5:
        parts.append(rod([-x, r, z_floor * 0.95], [x, r, z_floor * 0.95], r))
    t = rng.uniform(0.012, 0.08)
    parts.append(slab(outline(width, depth, rng.uniform(4, 16)), y - 0.3 * t, y + 0.7 * t, 0.3 * t))
    parts.append(rod([-x, y, z], [x, y, z], r))
    parts += (
        backrest(rng, width, y + 0.05, reach - 0.05, z, np.arctan(slope))
        if rng.random() < 0.4
        else [
            panel(
                np.full(5, width),
                y + reach * np.linspace(0.25, 1, 5),
                z + slope * reach * np.linspace(0.25, 1, 5),
                t,
                rng.uniform(0, 0.03),
            )
        ]
    )
    if rng.random() < 0.45:
        height = rng.uniform(0.17, 0.25)
        knots = [[x, y, -z], [x, y + height, -z * 0.9], [x, y + height, z + slope * height]]
        parts += mirrored(
            [tube(smooth_path(knots, bend), r), box([0.05, 0.025, depth * 0.6], [x, y + height, 0])]
        )
    return canonical(parts)


def lounge_frame(rng: Generator) -> trimesh.Trimesh:
    """A bentwood or tube lounge chair: springy sides that carry one long reclined cushion."""
    width, depth = rng.uniform(0.56, 0.75), rng.uniform(0.55, 0.75)
    y, reach, r = rng.uniform(0.36, 0.42), rng.uniform(0.45, 0.7), rng.uniform(0.016, 0.03)
    x, z, slope = width / 2, depth / 2, rng.uniform(0.3, 0.55)
    height = rng.uniform(0.15, 0.24)
    side = [[x, r, z * 0.9], [x, r, -z * 0.8], [x, y + height, -z], [x, y + height, z * 0.8]]
    parts = mirrored(
        [tube(smooth_path(side, 0.12), r, aspect=rng.uniform(0.5, 1.0), sections=int(rng.choice([4, 12])))]
    )
    parts += [rod([-x, r, s * z * 0.7], [x, r, s * z * 0.7], 0.7 * r) for s in (-1, 1)]
    t = rng.uniform(0.03, 0.12)
    inner = width - 2 * r
    cushion = slab(outline(inner, depth, 8.0), y - t, y, 0.4 * t)
    cushion.apply_transform(
        trimesh.transformations.rotation_matrix(rng.uniform(0.05, 0.2), [1, 0, 0], [0, y, 0])
    )
    v = np.linspace(0, 1, 6)
    back = panel(
        np.full(6, inner), y - 0.1 + reach * v, z - 0.05 + slope * reach * v, t, rng.uniform(0, 0.04)
    )
    parts += [cushion, back, *mirrored([rod([x, r, z * 0.85], [x, y + height * 0.9, z * 0.75], r)])]
    return canonical(parts)


def folding_chair(rng: Generator) -> trimesh.Trimesh:
    """Crossed side frames, a thin seat, and a short back."""
    width, depth, y = rng.uniform(0.38, 0.48), rng.uniform(0.36, 0.44), rng.uniform(0.42, 0.47)
    reach, r, x = rng.uniform(0.3, 0.42), rng.uniform(0.009, 0.016), width / 2
    long_leg = smooth_path([[x, 0, -depth * 0.55], [x, y, depth * 0.35], [x, y + reach, depth * 0.55]], 0.05)
    parts = mirrored([tube(long_leg, r), rod([x - 2 * r, 0, depth * 0.55], [x - 2 * r, y, -depth * 0.4], r)])
    parts += [slab(outline(width - 4 * r, depth, 8.0), y - 0.02, y + rng.uniform(0, 0.03))]
    parts += [
        rod([-x, 0.1, -depth * 0.45], [x, 0.1, -depth * 0.45], r),
        rod([-x, 0.1, depth * 0.42], [x, 0.1, depth * 0.42], r),
    ]
    height = rng.uniform(0.12, 0.9 * reach)
    v = np.linspace(0, 1, 4)
    z = depth * (0.35 + 0.2 * (reach - height * (1 - v)) / reach)
    parts.append(
        panel(
            np.full(4, width), y + reach - height * (1 - v), z, rng.uniform(0.012, 0.03), rng.uniform(0, 0.02)
        )
    )
    return canonical(parts)
