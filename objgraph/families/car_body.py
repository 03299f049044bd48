"""The body of a car: a lower body lofted along z, with hollow wheel arches, and a greenhouse lofted along y."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.families.parts import loft, mirrored, outline

_THIN = 0.06
"""Least metal above a wheel arch, metres."""


@dataclass(frozen=True)
class CarShape:
    """The numbers that make a car's body; metres, `share` of the length from the nose or of the height."""

    length: float
    width: float
    height: float
    """Of the roof above the ground."""
    clearance: float
    """Of the underside above the ground."""
    wheel_radius: float
    wheel_width: float
    wheel_inset: float
    """Of the tyre's outer face behind the body's greatest half width; negative where it sticks out."""
    front_axle: float
    rear_axle: float
    """Share of the length."""
    nose_height: float
    cowl_height: float
    deck_height: float
    tail_height: float
    """Of bonnet and boot at their ends, share of the height: nose, windscreen, rear window, tail."""
    cowl: float
    screen_top: float
    roof_end: float
    deck: float
    """Where the windscreen begins and ends, where the rear window begins and ends; share of the length."""
    nose_lean: float
    tail_lean: float
    """How far the top of nose and tail is set back against their bottom."""
    nose_length: float
    tail_length: float
    """Over which the ends are rounded, share of the length."""
    nose_width: float
    tail_width: float
    """Of the end faces, share of the width."""
    nose_drop: float
    tail_drop: float
    """How much the top falls over the rounding."""
    nose_rise: float
    tail_rise: float
    """How much the underside rises from the axle to the end."""
    end_exponent: float
    """Of the superellipse that rounds the ends; large is boxy."""
    tumblehome: float
    """Loss of the greenhouse's width from belt to roof, a share."""
    belt_width: float
    """Of the greenhouse at the belt, share of the width."""
    roof_taper: float
    """Loss of the greenhouse's width from its front to its rear, a share."""
    roof_slope: float
    """How much the roof falls towards the rear."""
    roof_crown: float
    screen_bow: float
    """Exponent of the windscreen's and the rear window's side profile; 1 is straight."""
    corner: float
    """Exponent of the greenhouse's outline, see `parts.outline`."""
    sill_inset: float
    shoulder_inset: float
    """Loss of the lower body's width at its bottom and at its top, shares."""
    body_crown: float
    edge: float
    """Rounding of the lower body's upper edges."""
    arch: float
    """Radius of the wheel arches in wheel radii; below 1 there are none."""
    arch_exponent: float
    bed_front: float
    bed_depth: float
    """Where a pick-up's bed begins, share of the length, and its depth; no bed where the depth is below 0.1."""

    @property
    def has_bed(self) -> bool:
        return self.bed_depth >= 0.1

    @property
    def axles(self) -> tuple[float, float]:
        """z of the axles."""
        return (self.front_axle - 0.5) * self.length, (self.rear_axle - 0.5) * self.length

    def z(self, share: float) -> float:
        """z at a share of the length from the nose."""
        return (share - 0.5) * self.length


def body(shape: CarShape) -> list[trimesh.Trimesh]:
    """Lower body, greenhouse and, on pick-ups, the walls of the bed."""
    return [lower_body(shape), greenhouse(shape), *(_bed_walls(shape) if shape.has_bed else [])]


def lower_body(shape: CarShape) -> trimesh.Trimesh:
    """What lies below the belt line."""
    stations = _stations(shape)
    rings = np.stack([_section(shape, z) for z in stations])
    # nose and tail lean: their tops move inwards, least where the roundings end
    low, high = shape.clearance, max(shape.nose_height, shape.tail_height) * shape.height
    tall = ((rings[..., 1] - low) / (high - low)).clip(0, 1.2)
    share = rings[..., 2] / shape.length + 0.5
    rings[..., 2] += shape.nose_lean * tall * (1 - share / 0.25).clip(0)
    rings[..., 2] -= shape.tail_lean * tall * ((share - 0.75) / 0.25).clip(0)
    return loft(rings)


def top_profile(shape: CarShape, z: float) -> float:
    """Height of the lower body's upper edge at z, without the roundings of the ends."""
    share = z / shape.length + 0.5
    knots = [0.0, shape.cowl, max(shape.deck, shape.cowl + 0.05), 1.0 + 1e-6]
    heights = [shape.nose_height, shape.cowl_height, shape.deck_height, shape.tail_height]
    return shape.height * float(np.interp(share, knots, heights))


def half_width(shape: CarShape, z: float) -> float:
    """Half the greatest width at z."""
    front, rear = _end_factors(shape, z)
    share = shape.nose_width + (1 - shape.nose_width) * front
    return 0.5 * shape.width * min(share, shape.tail_width + (1 - shape.tail_width) * rear)


def greenhouse(shape: CarShape) -> trimesh.Trimesh:
    """Windows and roof: plan outlines from the belt line to the roof, the windscreen leaning back."""
    unit = outline(2.0, 2.0, shape.corner)
    rings = []
    for t in (-0.08, 0.0, 0.25, 0.5, 0.75, 0.93):
        rings.append(_greenhouse_ring(shape, unit, t, 1.0))
    for shrink in (0.985, 0.95, 0.75, 0.45, 0.12):
        rings.append(_greenhouse_ring(shape, unit, 1.0, shrink))
    return loft(np.stack(rings))


def _greenhouse_ring(
    shape: CarShape, unit: Float[np.ndarray, "m 2"], t: float, shrink: float
) -> Float[np.ndarray, "m 3"]:
    """The outline at a share t of the way from belt to roof, or on the roof at a share of its extent."""
    rise = max(t, 0.0) ** shape.screen_bow
    front = shape.z(shape.cowl + (shape.screen_top - shape.cowl) * rise)
    rear = shape.z(shape.deck + (shape.roof_end - shape.deck) * rise)
    along = (1 + shrink * unit[:, 1]) / 2
    roof = shape.height - shape.roof_crown * shrink**2 - shape.roof_slope * along
    belt = shape.height * (shape.cowl_height + (shape.deck_height - shape.cowl_height) * along)
    wide = 0.5 * shape.width * shape.belt_width * (1 - shape.tumblehome * max(t, 0.0))
    x = shrink * unit[:, 0] * wide * (1 - shape.roof_taper * along)
    return np.stack([x, belt + (roof - belt) * t, front + (rear - front) * along], axis=1)


def _end_factors(shape: CarShape, z: float) -> tuple[float, float]:
    """How much of the full section is reached behind the nose and ahead of the tail, 0 to 1."""
    n = shape.end_exponent
    factors = []
    for distance, reach in ((z - shape.z(0), shape.nose_length), (shape.z(1) - z, shape.tail_length)):
        gone = 1 - min(max(distance, 0.0) / (reach * shape.length), 1.0)
        factors.append((1 - gone**n) ** (1 / n))
    return factors[0], factors[1]


def _stations(shape: CarShape) -> Float[np.ndarray, "k"]:
    """Where sections are needed: closely at rounded ends and arches, and at the kinks of the profile."""
    end = np.array([0, 0.02, 0.08, 0.2, 0.4, 0.65, 1.0])
    marks = [shape.z(0) + end * shape.nose_length * shape.length]
    marks.append(shape.z(1) - end * shape.tail_length * shape.length)
    marks.append(np.array([shape.z(s) for s in (shape.cowl, shape.deck, 0.5)]))
    if shape.arch >= 1:
        reach = shape.arch * shape.wheel_radius
        around = reach * np.array([-1.002, -0.998, -0.96, -0.85, -0.6, -0.3])
        marks += [axle + np.concatenate([around, [0.0], -around]) for axle in shape.axles]
    if shape.has_bed:
        front, rear = _bed_ends(shape)
        marks.append(np.array([front - 1e-3, front + 1e-3, rear - 1e-3, rear + 1e-3]))
    stations = np.unique(np.concatenate(marks).clip(shape.z(0), shape.z(1)))
    return stations[np.concatenate([[True], np.diff(stations) > 5e-4])]


def _section(shape: CarShape, z: float) -> Float[np.ndarray, "m 3"]:
    """The closed section at z, from the middle of the underside round both sides."""
    front, rear = _end_factors(shape, z)
    top = top_profile(shape, z) - shape.nose_drop * (1 - front) - shape.tail_drop * (1 - rear)
    crown = shape.body_crown * min(front, rear)
    if shape.has_bed and _bed_ends(shape)[0] < z < _bed_ends(shape)[1]:
        top, crown = top - shape.bed_depth, 0.0
    bottom = min(_underside(shape, z), top - 2 * _THIN)
    wide = half_width(shape, z)
    arch = min(max(bottom + 1e-4, _arch_height(shape, z)), top - _THIN)
    edge = min(shape.edge, 0.4 * (top - arch))
    levels = arch + (top - edge - arch) * np.array([0, 0.15, 0.35, 0.6, 0.85, 1.0])
    sides = wide * _fullness(shape, levels, bottom, top)
    well = min(0.5 * shape.width - shape.wheel_inset - 1.15 * shape.wheel_width, 0.9 * sides[0])
    lip = sides[-1] - 0.7 * edge
    half = [(well, bottom), (well + 1e-4, arch), *zip(sides, levels, strict=True)]
    half += [(lip + 0.4 * edge, top - 0.3 * edge), (lip - 0.3 * edge, top), (0.5 * lip, top + 0.75 * crown)]
    right = np.array(half)
    points = np.concatenate([[[0, bottom]], right, [[0, top + crown]], right[::-1] * [-1, 1]])
    return np.column_stack([points, np.full(len(points), z)])


def _fullness(
    shape: CarShape, y: Float[np.ndarray, "n"], bottom: float, top: float
) -> Float[np.ndarray, "n"]:
    """Share of the full width at heights of a section: less at the sill and at the shoulder."""
    h = ((y - bottom) / (top - bottom)).clip(0, 1)
    sill = shape.sill_inset * (1 - h / 0.4).clip(0) ** 2
    return 1 - sill - shape.shoulder_inset * ((h - 0.6) / 0.4).clip(0) ** 2


def _underside(shape: CarShape, z: float) -> float:
    ahead, behind = shape.axles
    before = max(ahead - z, 0.0) / (ahead - shape.z(0))
    after = max(z - behind, 0.0) / (shape.z(1) - behind)
    return shape.clearance + shape.nose_rise * before + shape.tail_rise * after


def _arch_height(shape: CarShape, z: float) -> float:
    """Height of the wheel arch's roof over z; 0 away from the wheels."""
    reach, n = shape.arch * shape.wheel_radius, shape.arch_exponent
    distance = min(abs(z - axle) for axle in shape.axles)
    if shape.arch < 1 or distance >= reach:
        return 0.0
    gone = distance / reach
    return shape.wheel_radius + reach * (1 - gone**n) ** (1 / n)


def _bed_ends(shape: CarShape) -> tuple[float, float]:
    return shape.z(shape.bed_front), shape.z(1) - 0.07


def _bed_walls(shape: CarShape) -> list[trimesh.Trimesh]:
    """The sides of a pick-up's bed; its front and rear walls are the lower body's."""
    thick, x = 0.07, 0.5 * shape.width * (1 - shape.shoulder_inset) - 0.035
    ends = np.array(_bed_ends(shape)) + [-0.02, 0.02]
    rings = []
    for z in ends:
        top = top_profile(shape, z)
        bottom = top - shape.bed_depth - 0.04
        rings.append([[x - thick, bottom, z], [x, bottom, z], [x, top, z], [x - thick, top, z]])
    return mirrored([loft(np.array(rings))])
