"""Tables of eight constructions; metres, floor at y = 0, the long side along x.

Each function draws its dimensions from the generator and returns the mesh and its symmetry class about y.
"""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.bench.worlds.boards import SIDES, half_round, lathe, ring, strip
from objgraph.synthetic.parts import beam, box, join, oval, rounded, sheet

Table = tuple[trimesh.Trimesh, int]


def gateleg(rng: Generator) -> Table:
    """A narrow frame with two leaves: up on gates that swing out, an oval; or hanging at the sides."""
    x, z, top = rng.uniform(0.5, 0.7), rng.uniform(0.38, 0.46), rng.uniform(0.7, 0.76)
    post, inset, r = rng.uniform(0.12, 0.17), z - 0.1, rng.uniform(0.018, 0.024)
    turned = np.array([1, 1, 0.6, 0.9, 1.25, 0.9, 0.65, 1.2, 1.2]) * r
    heights = np.array([0, 0.14, 0.2, 0.3, 0.42, 0.55, 0.66, 0.72, 1]) * (top - 0.01)
    profile = np.column_stack([turned, heights])
    parts = [box((-post, top - 0.1, -inset), (post, top - 0.01, inset))]
    for sx in SIDES:
        parts += [lathe(profile, sx * post, sz * inset, 10) for sz in SIDES]
        parts.append(beam([(sx * post, 0.1, -inset), (sx * post, 0.1, inset)], 0.9 * r, 4))
        parts.append(beam([(-post, 0.1, sx * inset), (post, 0.1, sx * inset)], 0.9 * r, 4))
    if rng.random() < 0.35:
        plate, drop = post + 0.05, rng.uniform(0.4, 0.6)
        parts.append(box((-plate, top - 0.02, -z), (plate, top, z)))
        for side in SIDES:
            near, far = sorted((side * plate, side * (plate + 0.02)))
            parts.append(box((near, top - drop, -z), (far, top, z)))
        folded = join(parts)
        folded.vertices = folded.vertices[:, [2, 1, 0]] * [1, 1, -1]
        return folded, 2
    out, swing = min(x - 0.1, rng.uniform(0.36, 0.5)), rng.uniform(0, 0.02)
    for side in SIDES:
        pivot, foot = (side * post, side * inset), (side * out, -side * swing)
        parts.append(lathe(profile, *foot, 10))
        for y in (0.1, top - 0.06):
            parts.append(beam([(pivot[0], y, pivot[1]), (foot[0], y, foot[1])], 0.9 * r, 4))
    parts.append(oval(x, z, top - 0.022, top, rng.uniform(2.0, 2.6)))
    return join(parts), 2


def picnic(rng: Generator) -> Table:
    """A garden table of planks with a bench on either side, all on slanted legs."""
    x, z = rng.uniform(0.75, 0.95), rng.uniform(0.34, 0.4)
    top, seat, out = rng.uniform(0.7, 0.76), rng.uniform(0.42, 0.46), rng.uniform(0.6, 0.7)
    thick, end = rng.uniform(0.03, 0.04), rng.uniform(0.68, 0.8)
    parts = []
    planks = int(rng.integers(4, 7))
    for at in (np.arange(planks) + 0.5) / planks * 2 * z - z:
        half = 0.92 * z / planks
        parts.append(box((-x, top - thick, at - half), (x, top, at + half)))
    wide = rng.uniform(0.11, 0.14)
    for side in SIDES:
        for at in (out - 0.53 * wide, out + 0.53 * wide):
            parts.append(box((-x, seat - thick, side * at - 0.5 * wide), (x, seat, side * at + 0.5 * wide)))
        leg = [(side * end * x, 0, sz * 0.9 * out) for sz in SIDES]
        for sz, foot in zip(SIDES, leg, strict=True):
            parts.append(strip([foot, (foot[0], top - 0.02, sz * 0.45 * z)], (0, 0, 0.05), 0.035))
        reach = out + wide
        rail = [
            (side * (end * x - 0.035), seat - 0.06, -reach),
            (side * (end * x - 0.035), seat - 0.06, reach),
        ]
        parts.append(strip(rail, (0, 0.04, 0), 0.035))
        batten = [(side * (end * x - 0.035), top - 0.06, s * 0.9 * z) for s in SIDES]
        parts.append(strip(batten, (0, 0.035, 0), 0.035))
        brace = [(side * (end * x - 0.04), seat - 0.05, 0), (side * 0.25 * x, top - 0.02, 0)]
        parts.append(beam(brace, 0.025, 4))
    return join(parts), 2


def c_side(rng: Generator) -> Table:
    """A side table that slides over a seat: top and foot are joined along the rear edge alone."""
    x, z, top = rng.uniform(0.22, 0.32), rng.uniform(0.17, 0.22), rng.uniform(0.5, 0.66)
    if rng.random() < 0.5:
        thick = rng.uniform(0.02, 0.035)
        low, high = thick / 2, top - thick / 2
        profile = rounded(
            [(0, low, -z), (0, low, z), (0, high, z), (0, high, -z)], rng.uniform(0.02, 0.08), 6
        )
        return join([strip(profile, (x, 0, 0), thick)]), 1
    r, foot = rng.uniform(0.01, 0.016), z * rng.uniform(0.85, 1.0)
    parts = [box((-x, top - 0.025, -z), (x, top, z))]
    for side in SIDES:
        at = side * (x - 0.03)
        frame = [(at, r, -foot), (at, r, z - r), (at, top - 0.02, z - r), (at, top - 0.02, 0.2 - z)]
        parts.append(beam(rounded(frame, rng.uniform(0.02, 0.05), 5), r, 8))
    for at in (r - foot, z - r):
        parts.append(beam([(0.03 - x, r, at), (x - 0.03, r, at)], r, 8))
    return join(parts), 1


def demilune(rng: Generator) -> Table:
    """A half-round table for the wall: apron, tapered legs, perhaps a lower shelf; the wall is at +z."""
    x, depth, top = rng.uniform(0.42, 0.6), rng.uniform(0.36, 0.44), rng.uniform(0.7, 0.78)
    z, apron, r = depth / 2, rng.uniform(0.08, 0.13), rng.uniform(0.018, 0.026)
    parts = [half_round(x, depth, z, top - 0.024, top)]
    skirt = half_round(0.9 * x, 0.88 * depth, z - 0.01, top - apron, top - 0.02)
    parts.append(skirt)
    bearings = np.deg2rad([6, *([90] if rng.random() < 0.3 else [60, 120]), 174])
    shelf = rng.uniform(0.14, 0.24)
    for a in bearings:
        at = (-0.84 * x * np.cos(a), z - 0.03 - 0.78 * depth * np.sin(a))
        parts.append(lathe([(0.6 * r, 0), (r, top - apron), (r, top - 0.01)], *at, 8))
    if rng.random() < 0.5:
        parts.append(half_round(0.88 * x, 0.84 * depth, z - 0.015, shelf, shelf + 0.02))
    return join(parts), 1


def platform(rng: Generator) -> Table:
    """A low table whose top is a row of slats, on frames that narrow towards the floor."""
    x, z, top = rng.uniform(0.5, 0.75), rng.uniform(0.25, 0.34), rng.uniform(0.41, 0.5)
    slats, height, r = int(rng.integers(7, 12)), rng.uniform(0.03, 0.05), rng.uniform(0.015, 0.022)
    half, under = 0.6 * z / slats, top - height
    parts = []
    for at in np.linspace(half - z, z - half, slats):
        parts.append(box((-x, under, at - half), (x, top, at + half)))
    ends = x * rng.uniform(0.6, 0.75)
    narrow = rng.uniform(0.62, 0.8)
    for side in SIDES:
        at = side * ends
        feet = [(at, under, 0.95 * z), (at, r, narrow * z), (at, r, -narrow * z), (at, under, -0.95 * z)]
        parts.append(beam(rounded(feet, 0.02), r, 4))
        parts.append(box((at - r, under - 0.02, -0.97 * z), (at + r, under + 0.4 * height, 0.97 * z)))
    parts.append(box((-0.9 * x, under - 0.01, -0.012), (0.9 * x, under + 0.01, 0.012)))
    return join(parts), 2


def plinth(rng: Generator) -> Table:
    """An oval top on two walls that are bent like brackets, hollow towards the middle or the ends."""
    x, z, top = rng.uniform(0.65, 0.9), rng.uniform(0.4, 0.5), rng.uniform(0.71, 0.77)
    half, bend, wall = z * rng.uniform(0.55, 0.7), rng.uniform(0.12, 0.22), rng.uniform(0.035, 0.06)
    at, flare = x * rng.uniform(0.45, 0.55), rng.uniform(0.8, 0.95)
    outward = 1.0 if rng.random() < 0.5 else -1.0
    parts = [oval(x, z, top - rng.uniform(0.025, 0.045), top, rng.uniform(2.0, 2.8))]
    u, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(0, top - 0.015, 7), indexing="ij")
    share = flare + (1 - flare) * (2 * y / top - 1) ** 2
    for side in SIDES:
        reach = at + outward * bend * (0.5 - u**2)
        parts.append(sheet(np.stack([side * reach * share, y, u * half * share], axis=-1), wall))
    if rng.random() < 0.4:
        parts.append(oval(0.72 * x, 0.72 * z, 0, 0.025))
    return join(parts), 2


def cage(rng: Generator) -> Table:
    """A round top on a sheaf of rods, drawn in at the waist and twisted."""
    top, low = rng.uniform(0.42, 0.74), rng.uniform(0.75, 0.95)
    radius = rng.uniform(0.32, 0.48) if top < 0.6 else rng.uniform(0.42, 0.58)
    crown, waist = radius * 0.85, radius * rng.uniform(0.35, 0.55)
    foot, twist = radius * low, rng.uniform(0.0, 0.9)
    parts = [oval(radius, radius, top - 0.025, top)]
    share = np.linspace(0, 1, 9)
    middle = rng.uniform(0.4, 0.55)
    width = np.where(
        share < middle,
        waist + (foot - waist) * np.clip(1 - share / middle, 0, None) ** 1.6,
        waist + (crown - waist) * (np.clip(share - middle, 0, None) / (1 - middle)) ** 1.6,
    )
    rods, r = int(rng.integers(24, 37)), rng.uniform(0.005, 0.008)
    for start in 2 * np.pi * np.arange(rods) / rods:
        angle = start + twist * share
        path = [width * np.cos(angle), r + share * (top - 0.02 - r), width * np.sin(angle)]
        parts.append(beam(np.column_stack(path), r, 6))
    for at in (0, int(np.argmin(width)), 8):
        parts.append(ring((width[at], width[at]), r + share[at] * (top - 0.02 - r), 1.2 * r))
    return join(parts), 0


def nest(rng: Generator) -> Table:
    """Two or three small tables, one under the other and a little drawn out."""
    x, z, top = rng.uniform(0.29, 0.36), rng.uniform(0.18, 0.22), rng.uniform(0.5, 0.6)
    thick, leg, drawn = rng.uniform(0.016, 0.026), rng.uniform(0.012, 0.018), rng.uniform(0.06, 0.1)
    panels = rng.random() < 0.4
    parts = []
    for k in range(int(rng.integers(2, 4))):
        half, y, at = x - k * (2.2 * leg + 0.02), top - k * (thick + 0.035), -k * drawn
        parts.append(box((-half, y - thick, at - z), (half, y, at + z)))
        for side in SIDES:
            near, far = sorted((side * half, side * (half - 2 * leg)))
            if panels:
                parts.append(box((near, 0, at - z), (far, y, at + z)))
                continue
            for edge in (at - z, at + z - 2 * leg):
                parts.append(box((near, 0, edge), (far, y, edge + 2 * leg)))
            parts.append(box((near, 0, at - z), (far, 2 * leg, at + z)))
    return join(parts), 1


TABLES: dict[str, Callable[[Generator], Table]] = {
    "gateleg": gateleg,
    "picnic": picnic,
    "c-side": c_side,
    "demilune": demilune,
    "platform": platform,
    "plinth": plinth,
    "cage": cage,
    "nest": nest,
}
