"""Armrests of office chairs."""

import trimesh
from numpy.random import Generator

from objgraph.families.parts import mirrored, outline, rod, slab, smooth_path, tube

Parts = list[trimesh.Trimesh]


def armrests(rng: Generator, width: float, depth: float, y: float, z_back: float) -> Parts:
    """T posts with pads, closed loops, L arms fixed to the back, or swept arms; both sides."""
    height = rng.uniform(0.16, 0.27)
    x = width / 2 + rng.uniform(0.0, 0.06)
    pad_width, pad_length, pad_height = (
        rng.uniform(0.04, 0.10),
        rng.uniform(0.20, 0.34),
        rng.uniform(0.015, 0.04),
    )
    z_pad = rng.uniform(-0.08, 0.06)
    shape = outline(pad_width, pad_length, float(rng.choice([3.0, 6.0])))
    pad = slab(shape, y + height - pad_height, y + height, 0.3 * pad_height)
    pad.apply_translation([x, 0, z_pad])
    r, aspect = rng.uniform(0.009, 0.02), rng.uniform(0.5, 2.0)
    y_low = y - rng.uniform(0.04, 0.09)
    kind = rng.choice(["post", "loop", "from_back", "swept"], p=[0.4, 0.25, 0.15, 0.2])
    y_pad = y + height
    if kind == "post":
        knots = [[0.1, y_low, z_pad], [x, y_low, z_pad]]
        knots.append([x, y_pad - 0.01, z_pad + rng.uniform(-0.03, 0.03)])
        return mirrored([pad, tube(smooth_path(knots, 0.04), r, aspect)])
    if kind == "loop":
        loop = _loop(rng, x, y_low, y_pad, (z_pad - pad_length / 2, z_pad + pad_length / 2), r, aspect)
        return mirrored([loop, pad] if rng.random() < 0.6 else [loop])
    if kind == "from_back":
        y_arm = y_pad - 0.01
        knots = [[x * 0.8, y_arm, z_back], [x, y_arm, z_back - 0.05], [x, y_arm, z_pad]]
        return mirrored([pad, tube(smooth_path(knots, 0.05), r)])
    knots = [[x - 0.04, y_low, z_pad], [x, y_low + 0.03, z_pad - 0.06]]
    knots += [[x, y_pad - 0.01, z_pad - pad_length * 0.35], [x, y_pad - 0.01, z_pad + 0.05]]
    knots.append([x * 0.85, y_pad + 0.05, z_back + 0.03])
    swept = tube(smooth_path(knots, 0.08), r, aspect)
    under = rod([0.08, y_low, z_pad], [x - 0.03, y_low, z_pad], r)
    return mirrored([swept, under] + ([pad] if rng.random() < 0.5 else []))


def _loop(
    rng: Generator, x: float, y_low: float, y_pad: float, ends: tuple[float, float], r: float, aspect: float
) -> trimesh.Trimesh:
    """A closed frame from under the seat, up in front, back along the arm, and down."""
    front, rear = ends
    knots = [[0.12, y_low, front * 0.5], [x, y_low, front * 0.6], [x, y_pad, front]]
    knots += [[x, y_pad, rear], [x, y_low, rear * 0.6], [0.12, y_low, rear * 0.5]]
    return tube(smooth_path(knots, rng.uniform(0.03, 0.09)), r, aspect)
