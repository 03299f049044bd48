"""What is mounted on a car's body: wheels, mirrors, bumpers, and things on the roof and the tail."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.car_body import CarShape, half_width, top_profile
from objgraph.families.parts import box, loft, mirrored, outline, rod, slab, smooth_path, tube

Parts = list[trimesh.Trimesh]


def wheels(rng: Generator, shape: CarShape) -> Parts:
    """Four wheels, hollowed at their outer faces or not; axles between them where the body leaves them bare."""
    radius, wide = shape.wheel_radius, shape.wheel_width
    outer = shape.width / 2 - shape.wheel_inset
    bevel, hollow = rng.uniform(0.02, 0.25) * wide, rng.uniform(0.0, 0.35) * wide * (rng.random() < 0.6)
    hub, sections = rng.uniform(0.5, 0.75), int(rng.choice([10, 14, 20]))
    profile = [(0.5, outer - wide), (1 - bevel / radius, outer - wide), (1.0, outer - wide + bevel)]
    profile += [(1.0, outer - bevel), (1 - bevel / radius, outer)]
    profile += [(hub + 0.03, outer), (hub, outer - hollow), (0.3, outer - hollow)]
    angles = 2 * np.pi * np.arange(sections) / sections
    circle = np.stack([np.zeros(sections), np.cos(angles), np.sin(angles)], axis=1)
    one = loft(np.stack([radius * r * circle + [x, 0, 0] for r, x in profile]))
    parts: Parts = []
    for axle in shape.axles:
        wheel = one.copy()
        wheel.apply_translation([0, radius, axle])
        parts += mirrored([wheel])
    if shape.clearance > 1.2 * radius:
        inner = outer - wide / 2
        parts += [rod([-inner, radius, z], [inner, radius, z], 0.05) for z in shape.axles]
    return parts


def mirrors(rng: Generator, shape: CarShape) -> Parts:
    """A pair of outside mirrors beside the windscreen's foot."""
    z = shape.z(shape.cowl) + rng.uniform(0.1, 0.5)
    wide, tall, deep = rng.uniform(0.1, 0.26), rng.uniform(0.08, 0.2), rng.uniform(0.05, 0.16)
    y = top_profile(shape, z) + rng.uniform(-0.05, 0.12) + tall / 2
    x = half_width(shape, z) * shape.belt_width * (1 - 0.3 * shape.tumblehome) - 0.04
    pad = slab(outline(wide, deep, float(rng.choice([2.5, 4.0, 12.0]))), y - tall / 2, y + tall / 2, 0.02)
    pad.apply_translation([x + wide / 2, 0, z])
    # the cabin's corners are rounded: an arm holds on to it
    return mirrored([pad, box([0.3, 0.3 * tall, 0.5 * deep], [x - 0.1, y, z + 0.1 * deep])])


def bumpers(rng: Generator, shape: CarShape) -> Parts:
    """A bar in front and one behind, sticking out a little."""
    tall, out = rng.uniform(0.08, 0.22), rng.uniform(0.02, 0.1)
    deep = rng.uniform(0.25, 0.6)
    low = max(shape.clearance, 0.2) + rng.uniform(-0.05, 0.12)
    corner = float(rng.choice([3.0, 5.0, 10.0, 20.0]))
    parts = []
    for sign, share in ((-1, shape.nose_width), (1, shape.tail_width)):
        wide = shape.width * rng.uniform(share, 1.02)
        bar = slab(outline(wide, deep, corner), low, low + tall, rng.uniform(0, 0.04))
        bar.apply_translation([0, 0, sign * (shape.length / 2 + out - deep / 2)])
        parts.append(bar)
    return parts


def roof_rails(rng: Generator, shape: CarShape) -> Parts:
    """Two rails along the roof, or a flat carrier on it."""
    front, rear = shape.z(shape.screen_top), shape.z(shape.roof_end)
    if rng.random() < 0.25:
        size = [0.6 * shape.width * rng.uniform(0.7, 1.1), rng.uniform(0.1, 0.3), 0.75 * (rear - front)]
        return [box(size, [0, roof_height(shape, 0.5) + 0.35 * size[1], (front + rear) / 2])]
    x = 0.5 * shape.width * shape.belt_width * (1 - shape.tumblehome) * rng.uniform(0.78, 0.9)
    lift, reach = rng.uniform(0.03, 0.08), rear - front
    start, end = roof_height(shape, 0.1) - shape.roof_crown, roof_height(shape, 0.9) - shape.roof_crown
    knots = [
        [x, start - 0.03, front + 0.08 * reach],
        [x, start + lift, front + 0.16 * reach],
        [x, end + lift, rear - 0.16 * reach],
        [x, end - 0.03, rear - 0.08 * reach],
    ]
    return mirrored([tube(smooth_path(knots, 0.05), rng.uniform(0.015, 0.03), sections=6)])


def roof_sign(rng: Generator, shape: CarShape) -> Parts:
    """A police car's light bar, in one or two pieces, or a taxi's sign."""
    along = rng.uniform(0.15, 0.6)
    z = shape.z(shape.screen_top + along * (shape.roof_end - shape.screen_top))
    y = roof_height(shape, along)
    tall, deep = rng.uniform(0.08, 0.2), rng.uniform(0.12, 0.3)
    wide = shape.width * (rng.uniform(0.2, 0.35) if rng.random() < 0.35 else rng.uniform(0.4, 0.75))
    plan = outline(wide, deep, float(rng.choice([3.0, 6.0, 20.0])))
    parts = [slab(plan, y - 0.05, y + tall, rng.uniform(0, 0.04))]
    if rng.random() < 0.25:
        parts = mirrored([box([wide * 0.42, tall + 0.05, deep], [wide * 0.27, y + tall / 2, 0])])
    for part in parts:
        part.apply_translation([0, 0, z])
    return parts


def spoiler(rng: Generator, shape: CarShape) -> Parts:
    """A wing on posts or a lip at the end of the boot."""
    z = shape.z(1) - shape.tail_lean - rng.uniform(0.05, 0.3)
    y = top_profile(shape, z) - 0.5 * shape.tail_drop
    lift = rng.uniform(0.12, 0.35) if rng.random() < 0.6 else 0.0
    wide, deep, thick = shape.width * rng.uniform(0.7, 0.98), rng.uniform(0.15, 0.4), rng.uniform(0.03, 0.08)
    if lift == 0:
        return [box([wide * 0.9, 2.5 * thick, deep], [0, y + thick, z], pitch=-rng.uniform(0.0, 0.3))]
    wing = box([wide, thick, deep], [0, y + lift, z], pitch=-rng.uniform(0.0, 0.25))
    x = wide * rng.uniform(0.25, 0.47)
    return [wing, *mirrored([box([0.06, lift + 0.1, 0.6 * deep], [x, y + lift / 2 - 0.05, z])])]


def roof_spoiler(rng: Generator, shape: CarShape) -> Parts:
    """A lip that lengthens the roof over the rear window."""
    wide = shape.width * shape.belt_width * (1 - shape.tumblehome) * (1 - shape.roof_taper)
    deep, thick = rng.uniform(0.2, 0.4), rng.uniform(0.03, 0.08)
    y = roof_height(shape, 1.0) - shape.roof_crown - 0.4 * thick
    return [box([wide * 0.9, thick, deep], [0, y, shape.z(shape.roof_end) + 0.2 * deep])]


def spare_wheel(rng: Generator, shape: CarShape) -> Parts:
    """A wheel on the tailgate."""
    wide, radius = rng.uniform(0.18, 0.28), shape.wheel_radius * rng.uniform(0.85, 1.0)
    y = shape.clearance + radius + rng.uniform(0.15, 0.45)
    z = shape.z(1) - shape.tail_lean * 0.7
    x = rng.uniform(-0.15, 0.15) * (rng.random() < 0.3)
    return [rod([x, y, z - 0.06], [x, y, z + wide], radius, sections=16)]


def side_steps(rng: Generator, shape: CarShape) -> Parts:
    """Running boards between the wheels."""
    front, rear = shape.axles
    gap = 1.15 * shape.wheel_radius
    tall, wide = rng.uniform(0.05, 0.12), rng.uniform(0.15, 0.3)
    x = shape.width / 2 * (1 - shape.sill_inset) - wide / 2 + rng.uniform(0.0, 0.08)
    size = [wide, tall, max(rear - front - 2 * gap, 0.3)]
    return mirrored([box(size, [x, shape.clearance + tall * rng.uniform(-0.3, 0.5), (front + rear) / 2])])


def flares(rng: Generator, shape: CarShape) -> Parts:
    """Fenders: half rings over the wheels that stick out of the body."""
    out = rng.uniform(0.02, 0.07)
    reach = shape.wheel_radius * max(shape.arch, rng.uniform(1.02, 1.12))
    thick = rng.uniform(0.04, 0.1)
    angles = np.linspace(rng.uniform(-0.1, 0.3), np.pi, 9)
    angles[-1] -= angles[0]
    arc = np.stack([np.zeros(9), np.sin(angles), np.cos(angles)], axis=1)
    x = shape.width / 2 - 0.5 * shape.wheel_width + out
    section = np.array([(0.5, 0.0), (0.5, 1.0), (-0.5, 1.0), (-0.5, 0.0)])
    rings = [
        np.stack([(reach + thick * up) * a + [x + shape.wheel_width * s, 0, 0] for s, up in section])
        for a in arc
    ]
    parts: Parts = []
    for axle in shape.axles:
        flare = loft(np.stack(rings))
        flare.apply_translation([0, shape.wheel_radius, axle])
        parts += mirrored([flare])
    return parts


def roof_height(shape: CarShape, along: float) -> float:
    """Height of the roof's middle line at a share of its length."""
    return shape.height - shape.roof_slope * along - 0.5 * shape.roof_crown * abs(2 * along - 1)
