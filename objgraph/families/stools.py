"""Backless seats: step stools, three bent legs, crossed legs, boxes, bar stools, pucks on a column."""

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from objgraph.families.parts import (
    box,
    canonical,
    mirrored,
    outline,
    ring_path,
    rod,
    slab,
    smooth_path,
    tube,
)
from objgraph.families.supports import column, corner_legs, floor_reach, rails

Parts = list[trimesh.Trimesh]


def seat_outline(rng: Generator, width: float, depth: float) -> Float[np.ndarray, "m 2"]:
    """Square, rounded, round, hexagonal to dodecagonal, or a rounded triangle."""
    kind = rng.choice(["box", "soft", "round", "polygon", "triangle"], p=[0.4, 0.15, 0.2, 0.15, 0.1])
    if kind == "triangle":
        angle = 2 * np.pi * np.arange(30) / 30
        reach = width / 2 * (0.85 + 0.15 * np.cos(3 * (angle - np.pi / 2)))
        return np.stack([np.cos(angle), np.sin(angle)], 1) * reach[:, None]
    if kind == "polygon":
        return outline(width, width, 2.0, int(rng.choice([6, 8, 12])))
    exponent = {"box": rng.uniform(9, 60), "soft": rng.uniform(3, 6), "round": 2.0}[kind]
    return outline(width, depth, exponent)


def legged_stool(rng: Generator) -> trimesh.Trimesh:
    """A seat on four legs of any section, from foot stool to bar height, with rails, rings or crosses."""
    width = rng.uniform(0.26, 0.5)
    depth = width * rng.uniform(0.65, 1.0)
    y = rng.choice([rng.uniform(0.2, 0.5), rng.uniform(0.45, 0.82)])
    t, r = rng.uniform(0.015, 0.09), rng.uniform(0.009, 0.035)
    parts = [slab(seat_outline(rng, width, depth), y - t, y, t * rng.uniform(0, 0.45), rng.uniform(0, 0.02))]
    inset = rng.uniform(0.5, 0.78)
    x, z = inset * width / 2, inset * depth / 2
    legs, spread = corner_legs(rng, x, z, y - t / 2, r)
    parts += legs
    if rng.random() < 0.75:
        parts += rails(rng, x, z, y - t, spread, r * rng.uniform(0.4, 0.9))
    if rng.random() < 0.3:
        height = rng.uniform(0.03, 0.07)
        parts += [box([2 * x, height, 0.02], [0, y - t - height / 2 + 0.002, s * z]) for s in (-1, 1)]
        parts += mirrored([box([0.02, height, 2 * z], [x, y - t - height / 2 + 0.002, 0])])
    return canonical(parts)


def step_stool(rng: Generator) -> trimesh.Trimesh:
    """A seat with a lower step in front, between side panels or on splayed legs."""
    width, depth, y = rng.uniform(0.32, 0.46), rng.uniform(0.2, 0.32), rng.uniform(0.4, 0.65)
    t, run, rise = rng.uniform(0.02, 0.04), rng.uniform(0.15, 0.26), y * rng.uniform(0.4, 0.6)
    front = -depth / 2 - run / 2
    parts = [box([width, t, depth], [0, y - t / 2, 0]), box([width * 0.95, t, run], [0, rise - t / 2, front])]
    x, s = width / 2 - rng.uniform(0.02, 0.05), rng.uniform(0.015, 0.03)
    if rng.random() < 0.4:
        sides = [box([s, y, depth * 0.95], [x, y / 2, 0]), box([s, rise, run], [x, rise / 2, front])]
        return canonical(parts + mirrored(sides))
    z = depth / 2 - 0.02
    legs = [rod([x, y, z], [x, 0, z + 0.05], s, sections=4)]
    legs.append(rod([x, y, -z], [x, 0, front - run / 2 + 0.02], s, sections=4))
    legs.append(rod([x, rise - t, front], [x, rise - t, z], 0.8 * s, sections=4))
    back = rod([-x, rise, z], [x, rise, z], 0.8 * s, sections=4)
    return canonical([*parts, *mirrored(legs), back])


def bent_leg_stool(rng: Generator) -> trimesh.Trimesh:
    """Three or four legs that come out from under a thin seat and bend down."""
    width, y, t = rng.uniform(0.34, 0.46), rng.uniform(0.4, 0.7), rng.uniform(0.015, 0.05)
    legs, r, reach = int(rng.integers(3, 5)), rng.uniform(0.01, 0.024), rng.uniform(0.38, 0.5) * width
    parts = [slab(seat_outline(rng, width, width), y - t, y, 0.4 * t)]
    for angle in np.pi / 2 + 2 * np.pi * np.arange(legs) / legs:
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        foot = out * reach * rng.uniform(1.0, 1.05) * 1.1
        under = np.array([0, y - t - 0.4 * r, 0])
        path = smooth_path([0.3 * reach * out + under, reach * out + under, foot], rng.uniform(0.04, 0.09))
        parts.append(tube(path, r, aspect=rng.uniform(0.6, 1.0)))
    if rng.random() < 0.4:
        parts.append(tube(ring_path(reach * 1.05, y * rng.uniform(0.25, 0.8)), 0.7 * r))
    return canonical(parts)


def crossed_stool(rng: Generator) -> trimesh.Trimesh:
    """Two X frames, on the sides or in front and behind, under a flat or padded seat."""
    width, depth, y = rng.uniform(0.36, 0.6), rng.uniform(0.3, 0.45), rng.uniform(0.38, 0.68)
    t, r = rng.uniform(0.02, 0.09), rng.uniform(0.01, 0.025)
    x, z = width / 2 - 2 * r, depth / 2 - 2 * r
    sections = int(rng.choice([4, 12]))
    parts = [slab(outline(width, depth, rng.uniform(4, 30)), y - t, y, 0.4 * t)]
    along = rng.random() < 0.5
    for s in (-1, 1):
        for side in (-1, 1):
            top, foot = ([side * x, y - t, s * z], [-side * x, 0, s * z])
            if along:
                top, foot = ([s * x, y - t, side * z], [s * x, 0, -side * z])
            parts.append(rod([*top[:1], top[1] + 0.003, top[2]], foot, r, sections=sections))
    middle = (y - t) / 2
    ends = ([-x, middle, 0], [x, middle, 0]) if along else ([0, middle, -z], [0, middle, z])
    return canonical([*parts, rod(*ends, 0.8 * r, sections=sections)])


def block_stool(rng: Generator) -> trimesh.Trimesh:
    """A box open on two sides, a cube on short feet, or a puck on a column."""
    width, y = rng.uniform(0.3, 0.55), rng.uniform(0.3, 0.5)
    depth, t = width * rng.uniform(0.7, 1.0), rng.uniform(0.015, 0.05)
    kind = rng.integers(3)
    if kind == 0:
        parts = [box([width, t, depth], [0, y - t / 2, 0])]
        parts += mirrored([box([t, y, depth], [width / 2 - t / 2, y / 2, 0])])
        if rng.random() < 0.5:
            parts.append(box([width, t, depth], [0, y * rng.uniform(0.1, 0.5), 0]))
        return canonical(parts)
    if kind == 1:
        foot = rng.uniform(0.02, 0.2)
        parts = [slab(seat_outline(rng, width, depth), foot, y, rng.uniform(0, 0.06), rng.uniform(0, 0.03))]
        legs, _ = corner_legs(rng, 0.33 * width, 0.33 * depth, foot + 0.02, rng.uniform(0.012, 0.035))
        return canonical(parts + legs)
    pad = rng.uniform(0.04, 0.2)
    y = rng.choice([y, rng.uniform(0.55, 0.8)])
    seat = slab(seat_outline(rng, width, width), y - pad, y, 0.45 * pad)
    return canonical([seat, *column(rng, y - 0.9 * pad, rng.uniform(0.25, 0.5) * width, rng.random() < 0.3)])


def bar_cluster(rng: Generator) -> trimesh.Trimesh:
    """A bar stool whose upright legs stand close together under a thick seat, tied by rails."""
    width, y, t = rng.uniform(0.3, 0.42), rng.uniform(0.6, 0.85), rng.uniform(0.04, 0.16)
    x, r = width * rng.uniform(0.22, 0.38), rng.uniform(0.012, 0.03)
    parts = [slab(seat_outline(rng, width, width), y - t, y, t * rng.uniform(0, 0.4))]
    legs, spread = corner_legs(rng, x, x, y - t / 2, r, chunky=True, splay=float(rng.choice([0.0, 0.06])))
    a, b = floor_reach(x, x, spread, 0.7)
    low = 0.3 * (y - t / 2)
    ring = mirrored([rod([a, low, -b], [a, low, b], 0.8 * r, sections=4)])
    ring += [rod([-a, low, s * b], [a, low, s * b], 0.8 * r, sections=4) for s in (-1, 1)]
    return canonical(parts + legs + ring)
