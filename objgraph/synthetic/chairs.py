"""Chairs of six constructions; metres, floor at y = 0, front at -z.

Each function draws its dimensions from the generator and returns the mesh.
"""

from collections.abc import Callable

import numpy as np
import trimesh

from objgraph.synthetic.parts import Point, arc, beam, box, join, oval, rounded, sheet

SIDES = (-1.0, 1.0)


def sled(rng: np.random.Generator) -> trimesh.Trimesh:
    """Two closed tube frames that stand on runners, a bent seat and a bent back."""
    x, z = rng.uniform(0.22, 0.27), rng.uniform(0.21, 0.25)
    seat, top, lean = rng.uniform(0.43, 0.47), rng.uniform(0.78, 0.92), rng.uniform(0.06, 0.12)
    tube = rng.uniform(0.011, 0.016)
    parts = [beam(rounded(_sled_frame(side * x, z, seat, top, lean, tube), 0.06), tube, 8) for side in SIDES]
    parts += [_rod((-x, tube, s * z * 0.8), (x, tube, s * z * 0.8), tube * 0.8) for s in SIDES]
    parts.append(_bent_seat(x - tube, z, seat + tube, rng.uniform(0.02, 0.05)))
    parts.append(_bent_back(x, z, seat + rng.uniform(0.12, 0.2), top, seat, lean, top))
    return join(parts)


def ladder_back(rng: np.random.Generator) -> trimesh.Trimesh:
    """Tapered, splayed legs; the rear ones bend back and carry curved slats."""
    x, z = rng.uniform(0.19, 0.23), rng.uniform(0.18, 0.22)
    seat, top, lean = rng.uniform(0.43, 0.48), rng.uniform(0.86, 1.05), rng.uniform(0.07, 0.14)
    splay, r = rng.uniform(0.02, 0.06), rng.uniform(0.015, 0.022)
    parts = [box((-x - 0.02, seat - 0.02, -z - 0.03), (x + 0.02, seat + 0.02, z + 0.01))]
    for side in SIDES:
        parts.append(beam([(side * (x + splay), 0, -z - splay), (side * x, seat, -z)], (0.6 * r, 1.2 * r)))
        parts.append(beam([(side * (x + splay), 0, z + splay), (side * x, seat, z)], (0.6 * r, 1.2 * r)))
        post = arc(
            (side * x, seat, z), (side * x, (seat + top) / 2, z + 0.3 * lean), (side * x, top, z + lean)
        )
        parts.append(beam(post, np.linspace(1.2 * r, 0.7 * r, len(post))))
        parts.append(
            _rod((side * (x + splay / 2), seat / 2, -z), (side * (x + splay / 2), seat / 2, z), 0.6 * r)
        )
    slats = int(rng.integers(3, 6))
    height, bulge = 0.5 * (top - seat) / slats, rng.uniform(0.02, 0.04)
    for y in np.linspace(seat + 0.14, top - height / 2 - 0.01, slats):
        share = (y - seat) / (top - seat)
        parts.append(_slat(x, y, height, z + lean * share**1.7, bulge))
    return join(parts)


def wire(rng: np.random.Generator) -> trimesh.Trimesh:
    """Four hairpin legs of bent wire, a padded oval seat, and a hoop filled with wires for a back."""
    x, z = rng.uniform(0.2, 0.24), rng.uniform(0.2, 0.23)
    seat, top, lean = rng.uniform(0.43, 0.47), rng.uniform(0.74, 0.88), rng.uniform(0.08, 0.14)
    r, spread = rng.uniform(0.007, 0.011), rng.uniform(0.05, 0.08)
    parts = [oval(x, z, seat - 0.015, seat + rng.uniform(0.02, 0.05), rng.uniform(2.2, 4.0))]
    for sx in SIDES:
        for sz in SIDES:
            foot = (sx * x * 1.02, r, sz * z * 1.02)
            a = (sx * (0.72 * x - spread), seat, sz * 0.72 * z)
            b = (sx * 0.72 * x, seat, sz * (0.72 * z - spread))
            parts.append(beam(rounded([a, foot, b], 0.03), r, 8))
    w = 0.9 * x

    def on_back(u: float, share: float) -> Point:
        return (u * w, seat + share * (top - seat), 0.8 * z * (1 - 0.25 * u * u) + lean * share)

    hoop = rounded([on_back(-0.8, 0), on_back(-1, 1), on_back(1, 1), on_back(0.8, 0)], 0.12, 6)
    parts.append(beam(hoop, 1.2 * r, 8))
    parts += [beam([on_back(u, 0), on_back(u, 0.99)], 0.7 * r, 6) for u in np.linspace(-0.6, 0.6, 7)]
    parts += [
        beam([on_back(u, share) for u in np.linspace(-0.9, 0.9, 7)], 0.7 * r, 6) for share in (0.35, 0.68)
    ]
    return join(parts)


def tub(rng: np.random.Generator) -> trimesh.Trimesh:
    """A thick wall bent around a round cushion, on four splayed legs."""
    radius, wall = rng.uniform(0.29, 0.34), rng.uniform(0.05, 0.08)
    seat, top = rng.uniform(0.4, 0.45), rng.uniform(0.72, 0.82)
    arm, bottom = rng.uniform(0.58, 0.66), rng.uniform(0.2, 0.26)
    reach = np.deg2rad(rng.uniform(105, 130))
    angle, share = np.meshgrid(np.linspace(-reach, reach, 33), np.linspace(0, 1, 8), indexing="ij")
    rim = arm + (top - arm) * np.cos(np.clip(angle / reach, -1, 1) * np.pi / 2) ** 2
    flare = radius * (1 + 0.08 * share)
    shell = np.stack([flare * np.sin(angle), bottom + share * (rim - bottom), flare * np.cos(angle)], axis=-1)
    inner = radius - wall / 4
    parts = [sheet(shell, wall), oval(inner, inner, bottom, seat, rng.uniform(2.0, 2.6))]
    return join(parts + _splayed_legs(radius * 0.62, bottom + 0.02, rng.uniform(0.05, 0.09), 0.022))


def shell(rng: np.random.Generator) -> trimesh.Trimesh:
    """A bucket bent from one sheet, on four thin legs with crossed braces."""
    width, depth = rng.uniform(0.21, 0.25), rng.uniform(0.4, 0.46)
    seat, top = rng.uniform(0.42, 0.46), rng.uniform(0.76, 0.86)
    wing, lean = rng.uniform(0.06, 0.12), rng.uniform(0.08, 0.14)
    # the middle line from front edge to crown: columns z and y
    front, heel, crown = (-depth / 2, seat), (depth / 2, seat - 0.04), (depth / 2 + lean, top)
    profile = _resample(rounded([front, heel, crown], 0.16, 8), 24)
    t = np.linspace(0, 1, len(profile))
    narrow = 1 - 1.4 * np.clip(t - 0.6, 0, None) ** 2 - 0.2 * np.clip(1 - t / 0.15, 0, None)
    u = np.linspace(-1, 1, 15)
    lift = wing * np.sin(np.pi * np.clip(t * 1.1, 0, 1)) ** 2
    upright = np.clip((t - 0.4) / 0.3, 0, 1)
    grid = np.stack(
        [
            np.outer(narrow * width, u),
            profile[:, 1:] + np.outer(lift * (1 - 0.6 * upright), u**2),
            profile[:, :1] - np.outer(lift * upright, u**2),
        ],
        axis=-1,
    )
    height, foot, r = seat - 0.01, rng.uniform(0.2, 0.24), 0.012
    parts = [sheet(grid, 0.014), oval(0.11, 0.1, seat - 0.055, seat - 0.015, 4.0)]
    parts += _splayed_legs(0.1, height - 0.02, foot - 0.1, r)
    middle = height * 0.62
    reach = 0.1 + (foot - 0.1) * (1 - middle / height)
    parts += [_rod((-reach, middle, s * reach), (reach, middle, -s * reach), 0.005) for s in SIDES]
    return join(parts)


def windsor(rng: np.random.Generator) -> trimesh.Trimesh:
    """A thick oval seat, turned splayed legs with an H of stretchers, and spindles under a bow."""
    x, z = rng.uniform(0.21, 0.25), rng.uniform(0.19, 0.23)
    seat, top, lean = rng.uniform(0.42, 0.46), rng.uniform(0.86, 1.02), rng.uniform(0.1, 0.17)
    splay = rng.uniform(0.05, 0.09)
    parts = [oval(x, z, seat - 0.04, seat, rng.uniform(2.2, 3.0))]
    turned = np.array([0.6, 0.9, 0.65, 1.15, 1.25, 0.9]) * rng.uniform(0.016, 0.02)
    share = np.linspace(0, 1, len(turned))[:, None]
    for sx in SIDES:
        for sz in SIDES:
            foot = np.array([sx * (0.6 * x + splay), 0, sz * (0.6 * z + splay)])
            head = np.array([sx * 0.6 * x, seat - 0.02, sz * 0.6 * z])
            parts.append(beam((foot + share * (head - foot)), turned))
        side = sx * (0.6 * x + 0.6 * splay)
        parts.append(
            _rod((side, 0.4 * seat, -0.6 * z - 0.6 * splay), (side, 0.4 * seat, 0.6 * (z + splay)), 0.01)
        )
    middle = 0.6 * (x + splay)
    parts.append(_rod((-middle, 0.4 * seat, 0), (middle, 0.4 * seat, 0), 0.01))
    angles = np.linspace(-np.pi / 2, np.pi / 2, 25)
    bow = np.column_stack(
        [
            0.9 * x * np.sin(angles) * (1 + 0.12 * np.cos(angles)),
            seat + (top - seat) * np.cos(angles) ** 0.55,
            0.45 * z + 0.4 * z * np.cos(angles) + lean * np.cos(angles) ** 0.55,
        ]
    )
    parts.append(beam(bow, 0.012, 8))
    for k in np.linspace(4, 20, int(rng.integers(6, 10))).round().astype(int):
        foot = np.array([0.75 * bow[k, 0], seat - 0.01, 0.45 * z + 0.3 * z * np.cos(angles[k])])
        parts.append(beam(np.stack([foot, bow[k]]), (0.009, 0.006), 6))
    return join(parts)


CHAIRS: dict[str, Callable[[np.random.Generator], trimesh.Trimesh]] = {
    "sled": sled,
    "ladder-back": ladder_back,
    "wire": wire,
    "tub": tub,
    "shell": shell,
    "windsor": windsor,
}


def _rod(start: Point, end: Point, radius: float) -> trimesh.Trimesh:
    return beam([start, end], radius, 8)


def _sled_frame(x: float, z: float, seat: float, top: float, lean: float, tube: float) -> list[Point]:
    return [(x, top, z + lean), (x, seat, z), (x, tube, z + 0.02), (x, tube, -z), (x, seat, -z), (x, seat, z)]


def _bent_seat(half_x: float, half_z: float, height: float, drop: float) -> trimesh.Trimesh:
    """A plate whose front edge falls by `drop`."""
    x, z = np.meshgrid(np.linspace(-half_x, half_x, 7), np.linspace(-half_z, half_z, 13), indexing="ij")
    y = (
        height
        - drop * np.clip((-z / half_z - 0.4) / 0.6, 0, None) ** 2
        - 0.1 * drop * (1 - (x / half_x) ** 2)
    )
    return sheet(np.stack([x, y, z], axis=-1), 0.018)


def _bent_back(
    half_x: float, z: float, low: float, high: float, seat: float, lean: float, top: float
) -> trimesh.Trimesh:
    """A plate between uprights that lean by `lean` from `seat` to `top`, hollow towards the sitter."""
    x, y = np.meshgrid(np.linspace(-half_x, half_x, 13), np.linspace(low, high, 9), indexing="ij")
    depth = z + lean * (y - seat) / (top - seat) + 0.03 * (1 - (x / half_x) ** 2)
    return sheet(np.stack([x, y, depth], axis=-1), 0.016)


def _slat(half_x: float, y: float, height: float, z: float, bulge: float) -> trimesh.Trimesh:
    x, dy = np.meshgrid(np.linspace(-half_x, half_x, 11), [-height / 2, 0, height / 2], indexing="ij")
    return sheet(np.stack([x, y + dy, z + bulge * (1 - (x / half_x) ** 2)], axis=-1), 0.014)


def _splayed_legs(inset: float, height: float, splay: float, radius: float) -> list[trimesh.Trimesh]:
    """Four tapered legs under a seat, their feet `splay` further out on either axis than their heads."""
    out = inset + splay
    return [
        beam([(sx * out, 0, sz * out), (sx * inset, height, sz * inset)], (0.6 * radius, radius))
        for sx in SIDES
        for sz in SIDES
    ]


def _resample(path: np.ndarray, count: int) -> np.ndarray:
    """Points at equal distances along a path."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, length[-1], count)
    return np.column_stack([np.interp(at, length, path[:, i]) for i in range(path.shape[1])])
