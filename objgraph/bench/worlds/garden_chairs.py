"""Chairs of gardens, balconies and beaches; metres, floor at y = 0, front at -z.

Each function draws its dimensions from the generator and returns the mesh.
"""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.bench.worlds.boards import SIDES, smooth, strip
from objgraph.synthetic.parts import Point, arc, beam, box, join, rounded, sheet


def adirondack(rng: Generator) -> trimesh.Trimesh:
    """A low slatted lounge chair: a reclined fan of boards with a round top, and wide flat arms."""
    x, z = rng.uniform(0.28, 0.33), rng.uniform(0.23, 0.27)
    front, rear = rng.uniform(0.36, 0.41), rng.uniform(0.25, 0.29)
    arm, top, slope = rng.uniform(0.55, 0.62), rng.uniform(0.86, 1.0), np.tan(rng.uniform(0.35, 0.48))

    def on_back(u: float, share: float) -> Point:
        return (u * (0.2 + 0.1 * share), rear + share * (top - rear), z + slope * share * (top - rear))

    behind = z + slope * (arm - rear) + 0.03
    parts = [beam([(-x - 0.02, arm - 0.03, behind), (x + 0.02, arm - 0.03, behind)], 0.025, 4)]
    for side in SIDES:
        runner = [
            (side * (x - 0.03), y, at)
            for y, at in ((front - 0.06, -z), (rear - 0.06, z), (0.045, z + rng.uniform(0.28, 0.3)))
        ]
        parts.append(strip(runner, (0, 0.045, 0), 0.026))
        parts.append(
            strip(
                [(side * x, 0, 0.07 - z), (side * x, arm, 0.07 - z)], (0, 0, rng.uniform(0.045, 0.06)), 0.028
            )
        )
        rest = [(side * (x + 0.02), arm, -z - 0.05), (side * (x + 0.02), arm, behind + 0.04)]
        parts.append(strip(rest, [(0.075, 0, 0), (0.05, 0, 0)], 0.024))
    slats = int(rng.integers(5, 8))
    along = np.array([0, rear - front, 2 * z]) / slats
    for k in range(slats):
        y, at = np.array([front - 0.01, -z]) + (k + 0.5) * along[1:]
        parts.append(strip([(-x + 0.02, y, at), (x - 0.02, y, at)], 0.44 * along, 0.02))
    boards = int(rng.integers(5, 8))
    round_top = rng.uniform(0.15, 0.28)
    for u in np.linspace(-1, 1, boards):
        end = 1 - round_top * u * u
        path = [on_back(u, share) for share in np.linspace(-0.1, end, 5)]
        width = 0.86 / (boards - 1) * np.linspace(0.2, 0.2 + 0.1 * end, 5)
        parts.append(strip(path, np.column_stack([width, 0 * width, 0 * width]), 0.02))
    return join(parts)


def monobloc(rng: Generator) -> trimesh.Trimesh:
    """The stacking armchair cast in plastic: a slotted, wrapped back that runs on into arms and front legs."""
    w, z = rng.uniform(0.23, 0.26), rng.uniform(0.2, 0.23)
    seat, top, arm = rng.uniform(0.41, 0.45), rng.uniform(0.78, 0.9), rng.uniform(0.62, 0.67)
    lean, wrap, band = rng.uniform(0.2, 0.3), rng.uniform(0.08, 0.14), rng.uniform(0.07, 0.12)
    crown = rng.uniform(0.02, 0.08)

    def on_back(u: float, y: float) -> Point:
        return (1.05 * w * u, y, z - 0.01 + lean * (y - seat) - wrap * u * u)

    x, depth = np.meshgrid(np.linspace(-w, w, 9), np.linspace(-z, z, 9), indexing="ij")
    dish = 0.02 * (1 - (x / w) ** 2) * (1 - (depth / z) ** 2)
    parts = [sheet(np.stack([x, seat - dish, depth], axis=-1), 0.014)]
    slats = int(rng.integers(5, 8))
    for u in np.linspace(-0.8, 0.8, slats):
        path = [on_back(u, y) for y in np.linspace(seat - 0.02, top - 0.5 * band - crown * u * u, 5)]
        parts.append(strip(path, (0.55 * w / slats, 0, 0), 0.014))
    grid = [
        [on_back(u, top - crown * u * u - share * band) for share in (0, 0.5, 1)]
        for u in np.linspace(-1, 1, 15)
    ]
    parts.append(sheet(np.array(grid), 0.018))
    splay = rng.uniform(0.03, 0.06)
    for side in SIDES:
        out = w + 0.03
        stile = [on_back(side, y) for y in np.linspace(seat - 0.02, top - crown - 0.3 * band, 5)]
        parts.append(strip(stile, (0.025, 0, 0), 0.016))
        begin = on_back(side * 1.04, arm + 0.03)
        knots = [begin, (side * out, arm, -0.85 * z), (side * (out + 0.4 * splay), 0, -z - splay)]
        parts.append(strip(rounded(knots, 0.09, 6), (0.036, 0, 0), 0.016))
        feet = [(knots[2], (side * w, arm - 0.1, -0.85 * z))]
        feet.append(((side * (w + 0.4 * splay), 0, z + splay), (side * (w - 0.02), seat, 0.85 * z)))
        for foot, head in feet:
            parts.append(strip([foot, head], [(0, 0, 0.022), (0, 0, 0.036)], 0.016))
            parts.append(strip([foot, head], [(0.022, 0, 0), (0.036, 0, 0)], 0.016))
        near, far = sorted((side * w, side * (w - 0.014)))
        parts.append(box((near, seat - 0.05, -z), (far, seat, z)))
    parts.append(box((-w, seat - 0.06, -z), (w, seat, -z + 0.014)))
    return join(parts)


def deck(rng: Generator) -> trimesh.Trimesh:
    """A folding beach chair: two frames that cross at the sides, a prop, and one hanging cloth."""
    x, r = rng.uniform(0.26, 0.3), rng.uniform(0.014, 0.019)
    top, front = rng.uniform(0.84, 1.0), rng.uniform(0.36, 0.44)
    z, reach = rng.uniform(0.36, 0.44), rng.uniform(0.44, 0.54)
    outer, prop = x + 2.4 * r, rng.uniform(0.55, 0.68)
    toe, crown, knee, heel = (r, -z), (top, reach), (front, -z - 0.06), (r, z)
    joint = (r + prop * (top - r), -z + prop * (reach + z))
    parts = []
    for side in SIDES:
        for at, (a, b) in ((x, (toe, crown)), (outer, (knee, heel)), (outer, (joint, heel))):
            # the bars that end at the heel lie side by side
            shift = 2.4 * r if a is joint else 0.0
            parts.append(beam([(side * (at + shift), *a), (side * (at + shift), *b)], r, 4))
    for half, at in ((x, toe), (x, crown), (outer, knee), (outer + 2.4 * r, heel), (outer + 2.4 * r, joint)):
        parts.append(beam([(-half, *at), (half, *at)], 0.9 * r, 8))
    sag = (rng.uniform(0.2, 0.27), rng.uniform(-0.12, -0.04))
    cloth = np.array([knee, (0.72 * front, -0.7 * z), sag, (0.45 * top, 0.42 * reach), crown])
    path = smooth(np.column_stack([np.zeros(5), cloth]))
    parts.append(strip(path, (x - 1.6 * r, 0, 0), 0.014))
    return join(parts)


def director(rng: Generator) -> trimesh.Trimesh:
    """A folding armchair of cloth: bars that cross in front and behind, runners, and flat arms on posts."""
    x, z, r = rng.uniform(0.24, 0.28), rng.uniform(0.17, 0.2), rng.uniform(0.012, 0.017)
    seat, arm, top = rng.uniform(0.43, 0.47), rng.uniform(0.62, 0.68), rng.uniform(0.82, 0.92)
    lean = rng.uniform(0.02, 0.07)
    parts = []
    for side in SIDES:
        parts.append(beam([(side * x, r, -z - 0.05), (side * x, r, z + 0.05)], r, 4))
        parts.append(beam([(side * x, seat, -z - 0.04), (side * x, seat, z + 0.04)], r, 4))
        for at in (-z, z):
            parts.append(
                beam([(-side * x, r, at + side * 1.1 * r), (side * x, seat, at + side * 1.1 * r)], r, 4)
            )
        parts.append(beam([(side * x, seat, -z), (side * x, arm, -z)], r, 4))
        parts.append(beam([(side * x, seat, z), (side * x, arm, z), (side * x, top, z + lean)], r, 4))
        rest = [(side * x, arm, -z - 0.06), (side * x, arm, z + 0.02)]
        parts.append(strip(rest, (rng.uniform(0.025, 0.04), 0, 0), 0.02))
    parts.append(strip(arc((-x, seat, 0), (0, seat - 0.035, 0), (x, seat, 0)), (0, 0, z + 0.01), 0.012))
    height, bow = rng.uniform(0.07, 0.1), 0.03
    middle = z + lean * (top - height - arm) / (top - arm)
    path = arc((-x, top - height, middle), (0, top - height, middle + bow), (x, top - height, middle))
    parts.append(strip(path, (0, height, lean * height / (top - arm)), 0.012))
    return join(parts)
