"""Office chairs: a star foot, a gas column, a seat, a back, armrests."""

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from objgraph.families.armrests import armrests
from objgraph.families.parts import (
    box,
    canonical,
    lathe,
    mirrored,
    outline,
    panel,
    ring_path,
    rod,
    slab,
    smooth_path,
    tube,
)

Parts = list[trimesh.Trimesh]


def star_base(rng: Generator, y_seat_bottom: float, arms: int = 5) -> Parts:
    """Star foot with castors or glides, gas column with its cover, and the mechanism under the seat."""
    radius, phase = rng.uniform(0.26, 0.37), rng.uniform(0, 2 * np.pi)
    wheel = rng.uniform(0.022, 0.034)
    y_tip = 2 * wheel + rng.uniform(0.0, 0.02)
    y_hub = y_tip + rng.uniform(0.0, 0.06)
    thick, slim = rng.uniform(0.018, 0.03), rng.uniform(0.011, 0.02)
    hub = rng.uniform(0.03, 0.05)
    parts = [lathe([(hub, y_hub - 0.035), (hub, y_hub + 0.025)])]
    castors = rng.random() < 0.8
    for angle in phase + 2 * np.pi * np.arange(arms) / arms:
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        tip = radius * out + [0, y_tip, 0]
        parts.append(tube([[0, y_hub, 0], tip], [thick, slim], sections=8))
        parts += _castor(rng, tip, out, wheel) if castors else [rod(tip, tip * [1, 0, 1], wheel * 0.7)]
    return parts + _column(rng, y_hub, y_seat_bottom)


def _column(rng: Generator, y_hub: float, y_seat_bottom: float) -> Parts:
    """Gas column with its cover, and mostly a mechanism box under the seat."""
    column = rng.uniform(0.014, 0.024)
    cover = rng.uniform(1.2, 1.9) * column
    y_cover = y_hub + (y_seat_bottom - y_hub) * rng.uniform(0.3, 0.8)
    parts = [lathe([(cover, y_hub - 0.01), (cover * 0.95, y_cover)])]
    parts.append(lathe([(column, y_hub), (column, y_seat_bottom)]))
    if rng.random() < 0.8:
        size = [rng.uniform(0.10, 0.22), rng.uniform(0.03, 0.06), rng.uniform(0.14, 0.28)]
        parts.append(box(size, [0, y_seat_bottom - size[1] / 2 + 0.01, rng.uniform(-0.02, 0.04)]))
    return parts


def _castor(rng: Generator, tip: np.ndarray, out: np.ndarray, wheel: float) -> Parts:
    """A twin wheel under the tip of an arm, turned any way, on a short stem."""
    turn = rng.uniform(0, 2 * np.pi)
    axle = np.array([np.cos(turn), 0.0, np.sin(turn)])
    centre = tip * [1, 0, 1] + [0, wheel, 0] + 0.3 * wheel * out
    half = rng.uniform(0.7, 1.0) * wheel
    return [
        rod(centre - half * axle, centre + half * axle, wheel),
        rod(tip, tip * [1, 0, 1] + [0, wheel, 0], 0.4 * wheel),
    ]


def office_back(rng: Generator, width: float, y: float, z: float, reach: float, gap: float) -> Parts:
    """A padded or mesh back with lumbar curve and wrap, on a spine where it floats above the seat."""
    tilt = rng.uniform(0.03, 0.30)
    v = np.linspace(0, 1, 9)
    lumbar = rng.uniform(-0.02, 0.05) * np.sin(np.pi * np.clip(v * 1.3, 0, 1))
    depths = z + np.tan(tilt) * reach * v - lumbar
    heights = y + gap + (reach - gap) * v
    waist = rng.uniform(0.85, 1.1)
    top = rng.uniform(0.65, 1.0)
    widths = width * np.interp(v, [0, 0.3, 0.75, 1], [rng.uniform(0.7, 1), waist, 1.0, top])
    widths *= np.where(v == v[-1], rng.uniform(0.75, 1.0), 1.0)
    thickness = rng.uniform(0.015, 0.10)
    parts = [panel(widths, heights, depths, thickness, rng.uniform(0.0, 0.09))]
    parts += _spine(rng, width, y, gap, reach, np.stack([v, depths]), thickness)
    if rng.random() < 0.2:
        parts += _headrest(rng, width, heights[-1], depths[-1], np.tan(tilt))
    return parts


def _spine(
    rng: Generator,
    width: float,
    y: float,
    gap: float,
    reach: float,
    middle: Float[np.ndarray, "2 k"],
    thickness: float,
) -> Parts:
    """One or two bars from under the seat to the back; `middle` is the back's z over its relative height."""
    foot = middle[1, 0] + thickness / 2 + rng.uniform(0.0, 0.03)
    rear = np.interp(rng.uniform(0.25, 0.6), *middle) + thickness / 2
    knots = [
        [0, y - 0.05, rng.uniform(-0.05, 0.05)],
        [0, y - 0.05, foot],
        [0, y + gap + 0.3 * (reach - gap), rear],
    ]
    if gap <= 0.01 and rng.random() >= 0.5:
        return []
    bar = tube(smooth_path(knots, 0.06), rng.uniform(0.012, 0.022), aspect=rng.uniform(0.4, 1.0))
    if rng.random() >= 0.25:
        return [bar]
    bar.apply_translation([width * rng.uniform(0.15, 0.35), 0, 0])
    return mirrored([bar])


def _headrest(rng: Generator, width: float, y: float, z: float, slope: float) -> Parts:
    low, high = y + rng.uniform(0.02, 0.08), y + rng.uniform(0.16, 0.24)
    ends = np.array([low, (low + high) / 2, high])
    wide = width * rng.uniform(0.45, 0.75)
    pad = panel(
        [wide * 0.9, wide, wide * 0.85], ends, z + slope * (ends - y) - 0.02, rng.uniform(0.03, 0.07), 0.03
    )
    return [pad, rod([0, y - 0.1, z - 0.1 * slope], [0, (low + high) / 2, z], 0.012)]


def swivel_chair(rng: Generator) -> trimesh.Trimesh:
    """An office chair: five-star base, gas column, seat, back, mostly with armrests."""
    width, depth = rng.uniform(0.42, 0.56), rng.uniform(0.40, 0.54)
    y, thickness = rng.uniform(0.40, 0.56), rng.uniform(0.03, 0.13)
    exponent = float(rng.choice([2.5, 3.0, 4.0, 6.0]))
    cushion = slab(outline(width, depth, exponent), y - thickness, y, 0.45 * thickness, rng.uniform(0, 0.03))
    if rng.random() < 0.3:
        cushion.apply_transform(
            trimesh.transformations.rotation_matrix(rng.uniform(0, 0.08), [1, 0, 0], [0, y, 0])
        )
    # the column stands under the middle of the seat or a little behind it
    cushion.apply_translation([0, 0, -rng.uniform(0.0, 0.05)])
    z_back = depth / 2 - rng.uniform(-0.02, 0.06)
    reach = rng.choice([rng.uniform(0.32, 0.50), rng.uniform(0.48, 0.80)], p=[0.6, 0.4])
    gap = rng.uniform(0.0, 0.2) * (rng.random() < 0.7)
    parts = [cushion, *star_base(rng, y - thickness, 5 if rng.random() < 0.95 else 4)]
    parts += office_back(rng, width * rng.uniform(0.78, 1.05), y - 0.02, z_back, reach, gap)
    if rng.random() < 0.72:
        parts += armrests(rng, width, depth, y, z_back)
    return canonical(parts)


def executive_chair(rng: Generator) -> trimesh.Trimesh:
    """A thickly padded office chair with a high or a middle back and padded loop arms."""
    width, depth = rng.uniform(0.48, 0.60), rng.uniform(0.46, 0.56)
    y, thickness = rng.uniform(0.44, 0.54), rng.uniform(0.08, 0.16)
    parts = [slab(outline(width, depth, 4.0), y - thickness, y, 0.45 * thickness, 0.02)]
    parts += star_base(rng, y - thickness)
    z_back, back = depth / 2 - 0.02, rng.uniform(0.06, 0.14)
    parts += office_back(rng, width * rng.uniform(0.9, 1.0), y - 0.05, z_back, rng.uniform(0.45, 0.85), 0.0)
    reach = rng.uniform(0.3, 0.6)
    v = np.linspace(0, 1, 5)
    parts.append(panel(np.full(5, width * 0.9), y - 0.04 + reach * v, z_back + 0.15 * reach * v, back))
    return canonical(parts + armrests(rng, width, depth, y, z_back))


def swivel_stool(rng: Generator) -> trimesh.Trimesh:
    """A work stool: a round seat on a star base, perhaps a foot ring or a small back."""
    y, t = rng.uniform(0.42, 0.75), rng.uniform(0.03, 0.09)
    width = rng.uniform(0.32, 0.44)
    parts = [slab(outline(width, width, 2.0), y - t, y, 0.4 * t), *star_base(rng, y - t)]
    if y > 0.6 and rng.random() < 0.6:
        parts += [tube(ring_path(0.2, 0.45 * y), 0.01), rod([-0.2, 0.45 * y, 0], [0.2, 0.45 * y, 0], 0.008)]
    if rng.random() < 0.5:
        parts += office_back(
            rng, width * 0.9, y - 0.02, width / 2, rng.uniform(0.25, 0.4), rng.uniform(0.1, 0.2)
        )
    return canonical(parts)
