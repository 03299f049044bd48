"""Tables of six constructions; metres, floor at y = 0, the long side along x.

Each function draws its dimensions from the generator and returns the mesh and its symmetry class about y.
"""

from collections.abc import Callable

import numpy as np
import trimesh

from objgraph.synthetic.parts import beam, box, column, join

SIDES = (-1.0, 1.0)
Table = tuple[trimesh.Trimesh, int]


def a_frame(rng: np.random.Generator) -> Table:
    """Two A-shaped end frames joined by a ridge beam."""
    x, z = rng.uniform(0.6, 0.8), rng.uniform(0.35, 0.45)
    top, r = rng.uniform(0.71, 0.77), rng.uniform(0.025, 0.035)
    end, foot = x * rng.uniform(0.72, 0.85), z * rng.uniform(0.8, 0.95)
    parts = [box((-x, top - 0.035, -z), (x, top, z))]
    for sx in SIDES:
        for sz in SIDES:
            parts.append(beam([(sx * end, 0, sz * foot), (sx * end, top - 0.03, sz * 0.05)], r, 4))
        reach = foot * 0.66
        parts.append(beam([(sx * end, 0.3 * top, -reach), (sx * end, 0.3 * top, reach)], 0.8 * r, 4))
    parts.append(beam([(-end, 0.3 * top, 0), (end, 0.3 * top, 0)], 0.9 * r, 4))
    return join(parts), 2


def parsons(rng: np.random.Generator) -> Table:
    """A top and four thick legs, all flush at the corners."""
    x = rng.uniform(0.4, 0.7)
    square = bool(rng.random() < 0.4)
    z = x if square else x * rng.uniform(0.55, 0.75)
    top, leg = rng.uniform(0.68, 0.76), rng.uniform(0.09, 0.13)
    parts = [box((-x, top - leg * 0.8, -z), (x, top, z))]
    for sx in SIDES:
        for sz in SIDES:
            corner, inner = (sx * x, 0.0, sz * z), (sx * (x - leg), top, sz * (z - leg))
            parts.append(box(np.minimum(corner, inner).tolist(), np.maximum(corner, inner).tolist()))
    return join(parts), 4 if square else 2


def octagonal(rng: np.random.Generator) -> Table:
    """An eight-cornered top and shelf on four splayed legs."""
    radius, top = rng.uniform(0.45, 0.6), rng.uniform(0.68, 0.75)
    turn, shelf = np.pi / 8, rng.uniform(0.2, 0.3)
    inset, out = radius * 0.4, radius * rng.uniform(0.52, 0.6)
    at_shelf = out + (inset - out) * shelf / top
    parts = [
        column(radius, top - 0.035, top, 8, turn),
        column(radius * 0.8, top - 0.1, top - 0.03, 8, turn),
        column(at_shelf * 1.35, shelf - 0.012, shelf + 0.012, 8, turn),
    ]
    parts += [
        beam([(sx * out, 0, sz * out), (sx * inset, top - 0.04, sz * inset)], (0.02, 0.032), 8)
        for sx in SIDES
        for sz in SIDES
    ]
    return join(parts), 4


def drum(rng: np.random.Generator) -> Table:
    """A closed cylinder, drawn in towards the floor, under an overhanging round top."""
    radius, top = rng.uniform(0.25, 0.34), rng.uniform(0.48, 0.6)
    body = radius * rng.uniform(0.82, 0.92)
    parts = [
        column(radius, top - 0.03, top, 48),
        column(body, 0.04, top - 0.02, 48, taper=rng.uniform(0.75, 0.9)),
        column(body * 0.95, 0.0, 0.05, 48),
    ]
    return join(parts), 0


def x_leg(rng: np.random.Generator) -> Table:
    """A small table whose long sides stand on crossed bars."""
    x, z = rng.uniform(0.3, 0.42), rng.uniform(0.2, 0.28)
    top, r = rng.uniform(0.5, 0.62), rng.uniform(0.016, 0.024)
    parts = [box((-x, top - 0.03, -z), (x, top, z))]
    for sz in SIDES:
        at = sz * (z - 0.04)
        for sx in SIDES:
            parts.append(beam([(sx * 0.9 * x, 0, at), (-sx * 0.85 * x, top - 0.02, at)], r, 4))
    for sx in SIDES:
        parts.append(beam([(sx * 0.87 * x, 0.02, -z + 0.04), (sx * 0.87 * x, 0.02, z - 0.04)], 0.8 * r, 4))
    parts.append(beam([(0, top / 2, -z + 0.04), (0, top / 2, z - 0.04)], 0.7 * r, 4))
    return join(parts), 2


def slab(rng: np.random.Generator) -> Table:
    """A low, bench-like table: a thick plank on two upright planks with a rail between them."""
    x, z = rng.uniform(0.5, 0.65), rng.uniform(0.22, 0.3)
    top, plank = rng.uniform(0.44, 0.52), rng.uniform(0.045, 0.065)
    end = x * rng.uniform(0.78, 0.92)
    parts = [box((-x, top - plank, -z), (x, top, z))]
    for side in SIDES:
        near, far = sorted((side * end, side * (end - plank)))
        parts.append(box((near, 0, -0.9 * z), (far, top - plank / 2, 0.9 * z)))
    parts.append(box((-end, 0.4 * top, -plank / 2), (end, 0.4 * top + 0.09, plank / 2)))
    return join(parts), 2


TABLES: dict[str, Callable[[np.random.Generator], Table]] = {
    "a-frame": a_frame,
    "parsons": parsons,
    "octagonal": octagonal,
    "drum": drum,
    "x-leg": x_leg,
    "slab": slab,
}
