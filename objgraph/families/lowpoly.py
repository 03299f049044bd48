"""Blocky pieces as game kits have them: thick seats and tops, stout legs, few faces, stylised proportions."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, mirrored, moved, outline, rod, slab
from objgraph.families.supports import column, corner_legs, floor_reach, rails

Parts = list[trimesh.Trimesh]


def block(size: list[float], centre: list[float], bevel: float) -> trimesh.Trimesh:
    """A box whose horizontal edges are bevelled."""
    plate = slab(outline(size[0], size[2], 14.0), -size[1] / 2, size[1] / 2, bevel)
    return moved(plate, centre)


def chunky_back(rng: Generator, width: float, y: float, z: float, t: float) -> Parts:
    """A plain or stepped slab, a slab on two posts, or thick slats."""
    reach = rng.uniform(0.25, 0.8)
    pitch = rng.uniform(0, 0.25)
    kind = rng.choice(["slab", "stepped", "posts", "slats", "cushioned"])
    middle = z + np.tan(pitch) * reach / 2

    def plate(wide: float, low: float, high: float, thick: float) -> trimesh.Trimesh:
        size = [wide, (high - low) * reach, thick]
        centre = [0, y + (low + high) / 2 * reach, z + np.tan(pitch) * (low + high) / 2 * reach]
        return box(size, centre, pitch=pitch)

    if kind == "slab":
        return [plate(width, -0.05, 1, t)]
    if kind == "stepped":
        return [plate(width, -0.05, 0.85, t), plate(width * rng.uniform(0.4, 0.8), 0.8, 1, t * 0.95)]
    if kind == "cushioned":
        inner = box([width * 0.8, reach * 0.8, 0.8 * t], [0, y + reach / 2, middle - 0.6 * t], pitch=pitch)
        return [plate(width, -0.05, 1, t), inner]
    wide = t * rng.uniform(0.8, 1.5)
    if kind == "posts":
        split = rng.uniform(0.3, 0.6)
        x = width * rng.uniform(0.15, 0.5) - wide / 2
        post = moved(plate(wide, -0.05, split + 0.1, t), [x, 0, 0])
        return [plate(width, split, 1, t), *mirrored([post])]
    parts = [plate(width, 0.8, 1, t)]
    for x in np.linspace(-0.5, 0.5, int(rng.integers(2, 5))) * (width - wide):
        parts.append(moved(plate(wide * 0.9, -0.05, 0.9, 0.9 * t), [x, 0, 0]))
    return parts


def chunky_chair(rng: Generator) -> trimesh.Trimesh:
    """A thick seat on stout square legs with a blocky back, perhaps with arms of beams."""
    width, depth = rng.uniform(0.4, 0.62), rng.uniform(0.4, 0.58)
    y, t = rng.uniform(0.26, 0.5), rng.uniform(0.04, 0.16)
    r = rng.uniform(0.025, 0.06)
    parts = [block([width, t, depth], [0, y - t / 2, 0], rng.uniform(0, 0.45) * t)]
    inset = r * rng.uniform(1.0, 2.2)
    x, z = width / 2 - inset, depth / 2 - inset
    legs, spread = corner_legs(rng, x, z, y - t / 2, r, chunky=True)
    parts += legs
    if rng.random() < 0.25:
        parts += rails(rng, x, z, y - t, spread, 0.5 * r)
    back = rng.uniform(0.03, 0.12)
    parts += chunky_back(rng, width * rng.uniform(0.85, 1.05), y, depth / 2 - back / 2, back)
    if rng.random() < 0.3:
        parts += beam_arms(rng, width, depth, y, rng.uniform(0.02, 0.05))
    return canonical(parts)


def beam_arms(rng: Generator, width: float, depth: float, y: float, r: float) -> Parts:
    """Square posts in front and square rails to the back."""
    height, x, z = (
        rng.uniform(0.14, 0.26),
        width / 2 + rng.uniform(-1, 0.9) * r,
        -depth * rng.uniform(0.25, 0.48),
    )
    post = rod([x, y - 0.03, z], [x, y + height, z], r, sections=4)
    rail = box([2 * r, 1.6 * r, depth / 2 - z], [x, y + height, (depth / 2 + z) / 2])
    return mirrored([post, rail])


def block_armchair(rng: Generator) -> trimesh.Trimesh:
    """Walls of one thickness round a seat block, on thin or stout legs or none; perhaps a foot rest."""
    width, depth = rng.uniform(0.55, 1.05), rng.uniform(0.55, 0.85)
    y, wall = rng.uniform(0.33, 0.46), rng.uniform(0.04, 0.2)
    foot = rng.choice([rng.uniform(0.0, 0.08), rng.uniform(0.12, 0.3)])
    arm = rng.uniform(0.08, 0.25)
    reach = arm + rng.uniform(0.06, 0.4)
    bevel = rng.uniform(0, 0.03)
    low = min(foot, y - 0.08)
    seat = block([width - 2 * wall + 0.01, y - low, depth], [0, (y + low) / 2, 0], bevel)
    side = block(
        [wall, y + arm - low, depth * rng.uniform(0.8, 1.0)],
        [width / 2 - wall / 2, (y + arm + low) / 2, 0],
        bevel,
    )
    side.apply_translation([0, 0, depth / 2 - side.bounds[1, 2]])
    pitch = rng.uniform(0, 0.2)
    back = box(
        [width - 0.01 - rng.choice([0, 2]) * wall, y + reach - low, wall],
        [0, (y + reach + low) / 2, 0],
        pitch=pitch,
    )
    back.apply_translation([0, low - back.bounds[0, 1], depth / 2 - 0.7 * wall])
    parts = [seat, back, *mirrored([side])]
    if low > 0.02:
        legs, _ = corner_legs(
            rng, width / 2 - 0.05, depth / 2 - 0.05, low + 0.02, rng.uniform(0.008, 0.04), True
        )
        parts += legs
    if rng.random() < 0.1:
        parts.append(box([width * 0.6, 0.05, 0.3], [0, low + 0.1, -depth / 2 - 0.13], pitch=-0.3))
    return canonical(parts)


def chunky_table(rng: Generator) -> trimesh.Trimesh:
    """A thick top on stout legs with a deep frame, floor rails, a closed end, or X ends with a beam."""
    width, depth = rng.uniform(0.6, 1.7), rng.uniform(0.5, 0.9)
    width = max(width, depth)
    y, t = rng.uniform(0.28, 0.8), rng.uniform(0.03, 0.11)
    r, kind = (
        rng.uniform(0.025, 0.065),
        rng.choice(["legs", "rails", "end", "cross"], p=[0.4, 0.3, 0.15, 0.15]),
    )
    parts = [block([width, t, depth], [0, y - t / 2, 0], t * rng.choice([0, 0.3]))]
    inset = r * rng.uniform(0.9, 2.5)
    x, z, under = width / 2 - inset, depth / 2 - inset, y - t + 0.003
    if rng.random() < 0.45:
        height = rng.uniform(0.03, 0.1)
        parts.append(box([2 * x, height, 2 * z], [0, under - height / 2, 0]))
    if kind == "cross":
        for side in (-0.8 * x, 0.8 * x):
            parts += [rod([side, under - 0.5 * r, s * z], [side, 0, -s * z], r, sections=4) for s in (-1, 1)]
        return canonical(
            [*parts, rod([-0.8 * x, under / 2, 0], [0.8 * x, under / 2, 0], 0.6 * r, sections=4)]
        )
    legs, spread = corner_legs(rng, x, z, under, r, chunky=True, splay=0.0 if rng.random() < 0.8 else 0.06)
    parts += legs
    if kind == "rails":
        parts += rails(rng, x, z, under, spread, r * rng.uniform(0.4, 0.8))
    if kind == "end":
        parts.append(box([2 * r, under * 0.98, 2 * z], [-x, under * 0.51, 0]))
        parts.append(rod([-x, 0.15 * y, 0], [x, 0.15 * y, 0], 0.6 * r, sections=4))
        a, b = floor_reach(x, z, spread, 0.85)
        parts.append(rod([a, 0.15 * y, -b], [a, 0.15 * y, b], 0.6 * r, sections=4))
    return canonical(parts)


def chunky_round_table(rng: Generator) -> trimesh.Trimesh:
    """A thick round or polygonal top on a stout column, a turned post, or stub legs."""
    width, y, t = rng.uniform(0.6, 1.3), rng.uniform(0.3, 0.78), rng.uniform(0.03, 0.11)
    shape = outline(width, width, 2.0, int(rng.choice([6, 8, 12, 16, 32])))
    parts = [slab(shape, y - t, y, t * rng.uniform(0, 0.4))]
    if rng.random() < 0.6:
        return canonical(parts + column(rng, y - t / 2, width * rng.uniform(0.18, 0.4), rng.random() < 0.5))
    reach = 0.33 * width * rng.uniform(0.7, 1.0)
    legs, _ = corner_legs(rng, reach, reach, y - t / 2, rng.uniform(0.02, 0.07), True)
    return canonical(parts + legs)
