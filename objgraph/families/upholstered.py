"""Easy chairs and stools."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.legged import four_legs
from objgraph.families.parts import (
    canonical,
    lathe,
    loft,
    mirrored,
    outline,
    panel,
    ring_path,
    rod,
    slab,
    tube,
)

Parts = list[trimesh.Trimesh]


def armchair(rng: Generator) -> trimesh.Trimesh:
    """An upholstered easy chair with block arms, on short legs, or a wooden lounge frame with cushions."""
    width, depth = rng.uniform(0.60, 1.0), rng.uniform(0.60, 0.95)
    y = rng.uniform(0.36, 0.46)
    legs = rng.uniform(0.0, 0.18)
    arm, arm_height = rng.uniform(0.05, 0.24), rng.uniform(0.12, 0.28)
    reach, back = rng.uniform(0.3, 0.65), rng.uniform(0.06, 0.24)
    inner = width - 2 * arm
    exponent = float(rng.choice([4.0, 8.0, 20.0]))
    bevel = rng.uniform(0, 0.05)
    parts = [slab(outline(width - 0.01, depth, 20.0), legs, y - 0.1, 0.01)]
    parts.append(
        slab(outline(inner + 0.02, depth * 0.98, exponent), y - 0.12, y, bevel, rng.uniform(0, 0.03))
    )
    heights = np.linspace(legs, y + reach, 8)
    tilt = rng.uniform(0.05, 0.3)
    depths = depth / 2 - back / 2 + tilt * np.clip(heights - y, 0, None)
    top = rng.uniform(0.7, 1.0)
    widths = width * np.interp(heights, [y + 0.4 * reach, y + reach], [1.0, top])
    parts.append(panel(widths, heights, depths, back, wrap=rng.uniform(0, 0.06)))
    arm_mesh = slab(
        outline(arm, depth * rng.uniform(0.8, 1.0), exponent), legs, y + arm_height, min(bevel, 0.45 * arm)
    )
    arm_mesh.apply_translation([width / 2 - arm / 2, 0, 0.02])
    if rng.random() < 0.85:
        parts += mirrored([arm_mesh])
    if legs > 0.03:
        x, z, r = width / 2 - 0.06, depth / 2 - 0.06, rng.uniform(0.012, 0.03)
        for s in (-1, 1):
            parts += mirrored([rod([x, legs + 0.02, s * z], [x, 0, s * z], r, r * rng.uniform(0.6, 1))])
    return canonical(parts)


def tub_chair(rng: Generator) -> trimesh.Trimesh:
    """A round-backed chair whose back and arms are one curved wall."""
    width, depth = rng.uniform(0.55, 0.85), rng.uniform(0.55, 0.80)
    y, legs = rng.uniform(0.38, 0.46), rng.uniform(0.02, 0.25)
    wall, rise_arm, rise_back = rng.uniform(0.03, 0.12), rng.uniform(0.1, 0.25), rng.uniform(0.28, 0.5)
    angles = np.linspace(-0.15 * np.pi, 1.15 * np.pi, 21)
    u = np.sin(np.clip(angles, 0, np.pi))
    rings = []
    base = max(legs, y - rng.uniform(0.12, 0.3))
    for angle, blend in zip(angles, u, strict=True):
        direction = np.array([np.cos(angle), 0, np.sin(angle)])
        height = rise_arm + (rise_back - rise_arm) * blend**2
        foot = direction * [width / 2, 1, depth / 2]
        inner = direction * [width / 2 - wall, 1, depth / 2 - wall]
        tip = np.array([0, 0, 0.15 * rise_back * blend])
        low, high = np.array([0, base, 0]), np.array([0, y + height, 0]) + tip
        rings.append([foot + low, inner + low, inner + high, foot + high])
    parts = [loft(np.array(rings))]
    parts.append(slab(outline(width - wall, depth - wall, 2.5), base, y, 0.02, rng.uniform(0, 0.03)))
    r = rng.uniform(0.01, 0.025)
    x, z = width * 0.33, depth * 0.33
    for s in (-1, 1):
        parts += mirrored([rod([x, base + 0.02, s * z], [x * 1.1, 0, s * z * 1.1], r, r * 0.7)])
    return canonical(parts)


def stool(rng: Generator) -> trimesh.Trimesh:
    """A backless seat: legs, a pedestal, or an upholstered block; from pouf to bar height."""
    width = rng.uniform(0.28, 0.48)
    depth = width * (1.0 if rng.random() < 0.6 else rng.uniform(0.7, 1.2))
    y, t = rng.uniform(0.38, 0.80), rng.uniform(0.02, 0.10)
    round_seat = rng.random() < 0.5
    shape = outline(width, width, 2.0) if round_seat else outline(width, depth, 10.0)
    parts = [slab(shape, y - t, y, 0.3 * t)]
    kind = rng.integers(4)
    if kind == 0:
        return canonical(parts + stool_foot(rng, width, y, t))
    if kind == 1:
        return canonical(parts + leg_ring(rng, width, y, t))
    if kind == 2 and y < 0.5:
        block = outline(width * 1.2, depth * 1.2, float(rng.choice([2.0, 4.0, 16.0])))
        return canonical([slab(block, 0, y, rng.uniform(0, 0.06))])
    inner = 0.78 if round_seat else 1.0
    return canonical(
        parts + four_legs(rng, width * inner, depth * inner, y - t / 2, rng.uniform(0.012, 0.025))
    )


def stool_foot(rng: Generator, width: float, y: float, t: float) -> Parts:
    """A column on a disc, with a ring for the feet under a high seat."""
    radius = rng.uniform(0.02, 0.035)
    parts = [lathe([(width * 0.45, 0), (width * 0.45, 0.02), (radius, 0.05), (radius, y - t)])]
    if y > 0.6:
        parts.append(tube(ring_path(width * 0.4, y * 0.35), 0.01))
    return parts


def leg_ring(rng: Generator, width: float, y: float, t: float) -> Parts:
    """Three or four spread legs, perhaps tied by a ring."""
    legs = int(rng.integers(3, 5))
    r, spread = rng.uniform(0.01, 0.022), rng.uniform(1.0, 1.6)
    parts = []
    for i in range(legs):
        angle = 2 * np.pi * (i + 0.5) / legs
        top = np.array([np.cos(angle), 0, np.sin(angle)]) * width * 0.42
        parts.append(rod(top + np.array([0, y - t, 0]), top * spread, r, r * rng.uniform(0.6, 1)))
    if rng.random() < 0.6:
        parts.append(tube(ring_path(width * 0.42 * (1 + (spread - 1) * 0.6), y * 0.4), r * 0.7))
    return parts
