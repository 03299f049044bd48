"""Garden chairs of slats, wooden lounge frames with loose cushions, and chairs with box walls on high legs."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, canonical, mirrored, outline, rod, slab
from objgraph.families.supports import corner_legs, rails, sled

Parts = list[trimesh.Trimesh]


def slat_seat(rng: Generator, width: float, depth: float, y: float) -> Parts:
    """Boards across or along, in a frame that carries them; their tops are at y."""
    count, t = int(rng.integers(4, 11)), rng.uniform(0.012, 0.03)
    share = rng.uniform(0.6, 0.92)
    frame = rng.uniform(0.03, 0.08)
    parts = mirrored([box([t, frame, depth], [width / 2 - t, y - t - frame / 2 + 0.004, 0])])
    parts += [
        box([width - t, frame, t], [0, y - t - frame / 2 + 0.004, s * (depth / 2 - t)]) for s in (-1, 1)
    ]
    if rng.random() < 0.6:
        size = depth / count * share
        return parts + [
            box([width, t, size], [0, y - t / 2, a]) for a in np.linspace(-0.5, 0.5, count) * (depth - size)
        ]
    size = width / count * share
    return parts + [
        box([size, t, depth], [a, y - t / 2, 0]) for a in np.linspace(-0.5, 0.5, count) * (width - size)
    ]


def slat_back(rng: Generator, width: float, y: float, z: float, reach: float, pitch: float) -> Parts:
    """Boards across two posts, or upright between two rails."""
    t, count, share = rng.uniform(0.012, 0.03), int(rng.integers(3, 9)), rng.uniform(0.5, 0.92)
    slope = np.tan(pitch)
    x, r = width / 2 - 0.02, rng.uniform(0.01, 0.025)
    parts = mirrored([rod([x, y - 0.05, z], [x, y + reach, z + slope * reach], r, sections=4)])
    if rng.random() < 0.65:
        size = reach / count * share
        heights = np.linspace(rng.uniform(0.05, 0.3) * reach, reach - size / 2, count)
        return parts + [box([width, size, t], [0, y + h, z + slope * h], pitch=pitch) for h in heights]
    for h in (0.08 * reach, 0.97 * reach):
        parts.append(box([width, 0.05, 1.4 * t], [0, y + h, z + slope * h], pitch=pitch))
    size = width / count * share
    for a in np.linspace(-0.5, 0.5, count) * (width - size):
        centre = [a, y + reach / 2, z + slope * reach / 2]
        parts.append(box([size, 0.92 * reach / np.cos(pitch), t], centre, pitch=pitch))
    return parts


def slatted_chair(rng: Generator) -> trimesh.Trimesh:
    """A garden chair, low lounge seat, corner seat or bench of slats, with or without arms."""
    low = rng.random() < 0.5
    width = rng.uniform(0.45, 0.9) if rng.random() < 0.8 else rng.uniform(0.9, 1.5)
    depth = rng.uniform(0.45, 0.8) if low else rng.uniform(0.4, 0.52)
    y = rng.uniform(0.24, 0.4) if low else rng.uniform(0.4, 0.5)
    pitch = rng.uniform(0.1, 0.5) if low else rng.uniform(0.03, 0.25)
    reach, r = rng.uniform(0.3, 0.65), rng.uniform(0.014, 0.035)
    x, z = width / 2 - 1.5 * r, depth / 2 - 1.5 * r
    parts = slat_seat(rng, width, depth, y)
    legs, spread = corner_legs(rng, x, z, y - 0.02, r, splay=0.0 if rng.random() < 0.7 else None)
    parts += legs
    if rng.random() < 0.25:
        parts += rails(rng, x, z, y - 0.05, spread, 0.5 * r)
    parts += slat_back(rng, width * rng.uniform(0.9, 1.0), y, depth / 2 - 0.02, reach, pitch)
    kind = rng.random()
    if kind < 0.35:
        parts += plank_arms(rng, x, z, y, pitch, r)
    elif kind < 0.45 and low:
        turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
        for part in slat_back(rng, depth, y, width / 2 - 0.02, reach, pitch):
            part.apply_transform(turn)
            parts.append(part)
    return canonical(parts)


def plank_arms(rng: Generator, x: float, z: float, y: float, pitch: float, r: float) -> Parts:
    """Flat boards on front posts, reaching to the leaning back."""
    height = rng.uniform(0.14, 0.24)
    rear = z + np.tan(pitch) * height + 0.04
    front = -z * rng.uniform(0.6, 1.1)
    post = rod([x, y - 0.05, front], [x, y + height, front], r, sections=4)
    board = box(
        [rng.uniform(2, 5) * r, rng.uniform(0.015, 0.03), rear - front + 0.04],
        [x + 0.5 * r, y + height, (rear + front) / 2],
    )
    return mirrored([post, board])


def wooden_lounge(rng: Generator) -> trimesh.Trimesh:
    """A wooden frame with arm boards that carries a slanted seat cushion and a leaning back cushion."""
    width, depth, y = rng.uniform(0.55, 0.8), rng.uniform(0.5, 0.7), rng.uniform(0.34, 0.44)
    reach, lean, slant = rng.uniform(0.4, 0.65), rng.uniform(0.25, 0.5), rng.uniform(0.05, 0.2)
    r, t = rng.uniform(0.014, 0.03), rng.uniform(0.05, 0.14)
    inner, x, z = width - 5 * r, width / 2 - r, depth / 2
    turn = trimesh.transformations.rotation_matrix(slant, [1, 0, 0], [0, y, 0])
    seat = slab(outline(inner, depth, rng.uniform(6, 20)), y - t, y, 0.4 * t)
    seat.apply_transform(turn)
    back = box([inner, reach, t], [0, y + 0.42 * reach, z + 0.42 * np.tan(lean) * reach], pitch=lean)
    arm = y + rng.uniform(0.12, 0.22)
    front, rear = -z * rng.uniform(0.7, 1.0), z * rng.uniform(0.7, 1.2)
    sections = int(rng.choice([4, 12]))
    frame = [
        rod([x, arm, front], [x, 0, front * rng.uniform(0.9, 1.2)], r, r * rng.uniform(0.6, 1), sections),
        rod([x, arm, rear], [x, 0, rear * rng.uniform(1.0, 1.3)], r, r * rng.uniform(0.6, 1), sections),
        box([rng.uniform(2, 4) * r, 1.5 * r, rear - front + 0.12], [x, arm, (rear + front) / 2]),
        rod([x, y - t / 2, front], [x, y - t, rear], r, sections=sections),
    ]
    ties = [rod([-x, y - t, a], [x, y - t, a], r, sections=sections) for a in (front * 0.8, rear * 0.8)]
    top = [-x, y + 0.6 * reach, z + 0.6 * np.tan(lean) * reach + 0.5 * t]
    if rng.random() < 0.5:
        post = rod(
            [x, y - t, z * 0.7], [x, y + 0.9 * reach, z + 0.9 * np.tan(lean) * reach + 0.4 * t], 0.8 * r
        )
        ties += mirrored([post])
    ties.append(rod(top, [x, top[1], top[2]], 0.8 * r))
    return canonical([seat, back, *mirrored(frame), *ties])


def parsons_armchair(rng: Generator) -> trimesh.Trimesh:
    """Upholstered walls round a seat, on high thin legs or a sled: a dining armchair."""
    width, depth, y = rng.uniform(0.5, 0.66), rng.uniform(0.48, 0.62), rng.uniform(0.42, 0.5)
    t, wall, reach = rng.uniform(0.05, 0.2), rng.uniform(0.025, 0.08), rng.uniform(0.28, 0.62)
    arm = rng.uniform(0.12, 0.24)
    parts = [slab(outline(width, depth, rng.uniform(8, 40)), y - t, y, rng.uniform(0, 0.02))]
    pitch = rng.uniform(0, 0.2)
    tall = reach + t
    back = box(
        [width, tall, wall], [0, y - t + tall / 2, depth / 2 + 0.5 * np.tan(pitch) * tall], pitch=pitch
    )
    side = box([wall, arm + t, depth], [width / 2 - wall / 2, y - t + (arm + t) / 2, 0])
    if rng.random() < 0.85:
        parts += mirrored([side])
    under, r = y - t + 0.01, rng.uniform(0.008, 0.024)
    x, z = width / 2 - 1.5 * r - 0.01, depth / 2 - 1.5 * r - 0.01
    if rng.random() < 0.25:
        return canonical([*parts, back, *sled(rng, x, z, under, r)])
    legs, spread = corner_legs(rng, x, z, under, r)
    if rng.random() < 0.2:
        legs += rails(rng, x, z, under, spread, 0.7 * r)
    return canonical([*parts, back, *legs])
