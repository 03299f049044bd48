"""Chairs on four legs, armchairs, stools and benches."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.prior.families.backs import backrest
from objgraph.prior.families.parts import (
    box,
    canonical,
    lathe,
    loft,
    mirrored,
    outline,
    panel,
    rod,
    slab,
    smooth_path,
    tube,
)

Parts = list[trimesh.Trimesh]


def seat(rng: Generator, width: float, depth: float, y_top: float, thickness: float) -> Parts:
    """A flat, rounded or cushioned seat."""
    shape = outline(width, depth, float(rng.choice([2.6, 3.0, 4.0, 8.0, 20.0], p=[0.1, 0.2, 0.3, 0.2, 0.2])))
    bevel = thickness * rng.uniform(0, 0.45)
    crown = thickness * rng.uniform(0.1, 0.4) if rng.random() < 0.4 else 0.0
    return [slab(shape, y_top - thickness, y_top, bevel, crown)]


def four_legs(
    rng: Generator, width: float, depth: float, y_top: float, radius: float, back_reach: float | None = None
) -> Parts:
    """Legs at the corners of a seat, straight or splayed, round or square; the rear pair may rise to a back."""
    splay_x, splay_z = rng.uniform(-0.01, 0.09, 2) * (rng.random() < 0.6)
    taper = rng.uniform(0.5, 1.0)
    sections = int(rng.choice([4, 12]))
    inset = rng.uniform(1.0, 2.5) * radius
    x, z = width / 2 - inset, depth / 2 - inset
    front = rod([x, y_top, -z], [x + splay_x, 0, -z - splay_z], radius, radius * taper, sections)
    rear = [rod([x, y_top, z], [x + splay_x, 0, z + splay_z], radius, radius * taper, sections)]
    if back_reach is not None:
        top = [x, y_top + back_reach * np.cos(0.15), z + back_reach * np.sin(0.15)]
        rear.append(rod([x, y_top - 0.02, z], top, radius, radius * 0.8, sections))
    parts = mirrored([front, *rear])
    if rng.random() < 0.45:
        parts += stretchers(rng, x, z, y_top, radius * 0.6)
    return parts


def stretchers(rng: Generator, x: float, z: float, y_top: float, radius: float) -> Parts:
    """Rails between the legs: sides, front and back, or an H."""
    y = y_top * rng.uniform(0.2, 0.5)
    parts = mirrored([rod([x, y, -z], [x, y, z], radius)])
    kind = rng.integers(3)
    if kind == 0:
        parts.append(rod([-x, y, 0], [x, y, 0], radius))
    elif kind == 1:
        parts += [rod([-x, y * 1.2, s * z], [x, y * 1.2, s * z], radius) for s in (-1, 1)]
    return parts


def apron(rng: Generator, width: float, depth: float, y_top: float) -> Parts:
    """A frame under the seat or top."""
    height, t = rng.uniform(0.03, 0.09), rng.uniform(0.015, 0.03)
    x, z = width / 2 - rng.uniform(0.02, 0.05), depth / 2 - rng.uniform(0.02, 0.05)
    y = y_top - height / 2
    sides = mirrored([box([t, height, 2 * z], [x, y, 0])])
    return sides + [box([2 * x, height, t], [0, y, s * z]) for s in (-1, 1)]


def wooden_arms(rng: Generator, width: float, depth: float, y_seat: float) -> Parts:
    """Arm rails on a front post, reaching to the back."""
    height, radius = rng.uniform(0.17, 0.26), rng.uniform(0.010, 0.025)
    x, z = width / 2 + rng.uniform(-0.01, 0.03), depth / 2
    z_front = -z * rng.uniform(0.3, 1.0)
    post = rod([x, y_seat - 0.05, z_front], [x, y_seat + height, z_front], radius)
    rail = box(
        [radius * rng.uniform(2, 4), radius * 1.8, z - z_front + 0.08],
        [x, y_seat + height, (z + z_front) / 2],
    )
    return mirrored([post, rail])


def dining_chair(rng: Generator) -> trimesh.Trimesh:
    """A side chair or carver: four legs, a seat, and one of the backs."""
    width, depth = rng.uniform(0.36, 0.54), rng.uniform(0.36, 0.52)
    y = rng.uniform(0.41, 0.50) if rng.random() < 0.85 else rng.uniform(0.6, 0.78)
    thickness = rng.uniform(0.015, 0.08)
    reach = rng.uniform(0.28, 0.62)
    radius = rng.uniform(0.011, 0.026)
    posts = rng.random() < 0.5
    parts = seat(rng, width, depth, y, thickness)
    parts += four_legs(rng, width, depth, y - thickness / 2, radius, reach if posts else None)
    if rng.random() < 0.4:
        parts += apron(rng, width, depth, y - thickness)
    parts += backrest(rng, width * rng.uniform(0.82, 1.0), y - 0.02, reach, depth / 2 - 0.03, tilt=0.15)
    if rng.random() < 0.3:
        parts += wooden_arms(rng, width, depth, y)
    return canonical(parts)


def shell_chair(rng: Generator) -> trimesh.Trimesh:
    """A moulded one-piece shell on splayed or wire legs."""
    width, depth = rng.uniform(0.40, 0.56), rng.uniform(0.40, 0.50)
    y, reach, t = rng.uniform(0.40, 0.47), rng.uniform(0.28, 0.45), rng.uniform(0.012, 0.03)
    v = np.linspace(0, 1, 9)
    lift = 0.03 * np.sin(np.pi * v)
    back = panel(
        width * (1 - 0.25 * v**2),
        y + reach * v,
        depth / 2 - 0.04 + 0.2 * reach * v - lift,
        t,
        wrap=rng.uniform(0.02, 0.16),
    )
    parts = [slab(outline(width, depth, 3.0), y - t, y, 0.4 * t), back]
    radius = rng.uniform(0.008, 0.018)
    x, z = width * rng.uniform(0.2, 0.35), depth * rng.uniform(0.2, 0.35)
    spread = rng.uniform(1.0, 1.7)
    for s in (-1, 1):
        parts += mirrored(
            [rod([x, y - t, s * z], [x * spread, 0, s * z * spread], radius, radius * rng.uniform(0.6, 1))]
        )
    if rng.random() < 0.4:
        parts += mirrored(
            [
                rod([x, y * 0.8, z], [x, y * 0.8, -z], radius * 0.7),
                rod([-x, y * 0.8, z], [x, y * 0.8, z], 0.006),
            ]
        )
    if rng.random() < 0.4:
        parts += wooden_arms(rng, width, depth, y)
    return canonical(parts)


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
    parts = [
        slab(outline(width, width if round_seat else depth, 2.0 if round_seat else 10.0), y - t, y, 0.3 * t)
    ]
    kind = rng.integers(4)
    if kind == 0:
        radius = rng.uniform(0.02, 0.035)
        profile = [(width * 0.45, 0), (width * 0.45, 0.02), (radius, 0.05), (radius, y - t)]
        parts.append(lathe(profile))
        if y > 0.6:
            parts.append(tube(ring_path(width * 0.4, y * 0.35), 0.01))
    elif kind == 1:
        legs = int(rng.integers(3, 5))
        r, spread = rng.uniform(0.01, 0.022), rng.uniform(1.0, 1.6)
        for i in range(legs):
            d = (
                np.array([np.cos(2 * np.pi * (i + 0.5) / legs), 0, np.sin(2 * np.pi * (i + 0.5) / legs)])
                * width
                * 0.42
            )
            parts.append(rod(d + np.array([0, y - t, 0]), d * spread, r, r * rng.uniform(0.6, 1)))
        if rng.random() < 0.6:
            parts.append(tube(ring_path(width * 0.42 * (1 + (spread - 1) * 0.6), y * 0.4), r * 0.7))
    elif kind == 2 and y < 0.5:
        parts = [
            slab(
                outline(width * 1.2, depth * 1.2, float(rng.choice([2.0, 4.0, 16.0]))),
                0,
                y,
                rng.uniform(0, 0.06),
            )
        ]
    else:
        inner = 0.78 if round_seat else 1.0
        parts += four_legs(rng, width * inner, depth * inner, y - t / 2, rng.uniform(0.012, 0.025))
    return canonical(parts)


def ring_path(radius: float, y: float) -> np.ndarray:
    """A horizontal circle, as the path of a footrest's tube."""
    angles = np.linspace(0, 2 * np.pi, 25)
    return np.stack([radius * np.cos(angles), np.full(25, y), radius * np.sin(angles)], 1)


def bench(rng: Generator) -> trimesh.Trimesh:
    """A bench with a back, wider than a chair, with slats or a panel and perhaps arms."""
    width, depth = rng.uniform(0.85, 1.4), rng.uniform(0.40, 0.60)
    y, t, reach = rng.uniform(0.40, 0.48), rng.uniform(0.02, 0.06), rng.uniform(0.3, 0.5)
    radius = rng.uniform(0.018, 0.035)
    parts = seat(rng, width, depth, y, t)
    parts += four_legs(rng, width, depth, y - t / 2, radius, reach)
    parts += backrest(rng, width * 0.96, y - 0.02, reach, depth / 2 - 0.03, tilt=0.15)
    if rng.random() < 0.5:
        parts += wooden_arms(rng, width, depth, y)
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
