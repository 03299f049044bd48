"""Chairs and benches on four legs."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.backs import backrest
from objgraph.families.parts import box, canonical, mirrored, outline, panel, rod, slab

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
