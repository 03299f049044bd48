"""Chairs on one foot or on bent tubes: swivel office chairs, pedestal, cantilever and sled frames."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.prior.families.backs import backrest
from objgraph.prior.families.parts import (
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
    column = rng.uniform(0.014, 0.024)
    cover = rng.uniform(1.2, 1.9) * column
    y_cover = y_hub + (y_seat_bottom - y_hub) * rng.uniform(0.3, 0.8)
    parts.append(lathe([(cover, y_hub - 0.01), (cover * 0.95, y_cover)]))
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
    spine = z + thickness / 2 + rng.uniform(0.0, 0.03)
    middle = np.interp(rng.uniform(0.25, 0.6), v, depths) + thickness / 2
    knots = [
        [0, y - 0.05, rng.uniform(-0.05, 0.05)],
        [0, y - 0.05, spine],
        [0, y + gap + 0.3 * (reach - gap), middle],
    ]
    if gap > 0.01 or rng.random() < 0.5:
        bar = tube(smooth_path(knots, 0.06), rng.uniform(0.012, 0.022), aspect=rng.uniform(0.4, 1.0))
        if rng.random() < 0.25:
            bar.apply_translation([width * rng.uniform(0.15, 0.35), 0, 0])
            parts += mirrored([bar])
        else:
            parts.append(bar)
    if rng.random() < 0.2:
        parts += _headrest(rng, width, heights[-1], depths[-1], np.tan(tilt))
    return parts


def _headrest(rng: Generator, width: float, y: float, z: float, slope: float) -> Parts:
    low, high = y + rng.uniform(0.02, 0.08), y + rng.uniform(0.16, 0.24)
    ends = np.array([low, (low + high) / 2, high])
    wide = width * rng.uniform(0.45, 0.75)
    pad = panel(
        [wide * 0.9, wide, wide * 0.85], ends, z + slope * (ends - y) - 0.02, rng.uniform(0.03, 0.07), 0.03
    )
    return [pad, rod([0, y - 0.1, z - 0.1 * slope], [0, (low + high) / 2, z], 0.012)]


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
    if kind == "post":
        knots = [
            [0.1, y_low, z_pad],
            [x, y_low, z_pad],
            [x, y + height - 0.01, z_pad + rng.uniform(-0.03, 0.03)],
        ]
        return mirrored([pad, tube(smooth_path(knots, 0.04), r, aspect)])
    if kind == "loop":
        front, rear = z_pad - pad_length / 2, z_pad + pad_length / 2
        knots = [
            [0.12, y_low, front * 0.5],
            [x, y_low, front * 0.6],
            [x, y + height, front],
            [x, y + height, rear],
        ]
        knots += [[x, y_low, rear * 0.6], [0.12, y_low, rear * 0.5]]
        loop = tube(smooth_path(knots, rng.uniform(0.03, 0.09)), r, aspect)
        return mirrored([loop, pad] if rng.random() < 0.6 else [loop])
    if kind == "from_back":
        arm = tube(
            smooth_path(
                [
                    [x * 0.8, y + height - 0.01, z_back],
                    [x, y + height - 0.01, z_back - 0.05],
                    [x, y + height - 0.01, z_pad],
                ],
                0.05,
            ),
            r,
        )
        return mirrored([pad, arm])
    knots = [
        [x - 0.04, y_low, z_pad],
        [x, y_low + 0.03, z_pad - 0.06],
        [x, y + height - 0.01, z_pad - pad_length * 0.35],
    ]
    knots += [[x, y + height - 0.01, z_pad + 0.05], [x * 0.85, y + height + 0.05, z_back + 0.03]]
    swept = tube(smooth_path(knots, 0.08), r, aspect)
    under = rod([0.08, y_low, z_pad], [x - 0.03, y_low, z_pad], r)
    return mirrored([swept, under] + ([pad] if rng.random() < 0.5 else []))


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
        angles = np.linspace(0, 2 * np.pi, 25)
        ring = np.stack([0.2 * np.cos(angles), np.full(25, 0.45 * y), 0.2 * np.sin(angles)], 1)
        parts += [tube(ring, 0.01), rod([-0.2, 0.45 * y, 0], [0.2, 0.45 * y, 0], 0.008)]
    if rng.random() < 0.5:
        parts += office_back(
            rng, width * 0.9, y - 0.02, width / 2, rng.uniform(0.25, 0.4), rng.uniform(0.1, 0.2)
        )
    return canonical(parts)


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
