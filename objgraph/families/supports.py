"""What seats and tops stand on: legs of many sections, rails between them, bent tubes, plates."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import lathe, mirrored, outline, rod, slab, smooth_path, tube

Parts = list[trimesh.Trimesh]


def leg(rng: Generator, top: list[float], foot: list[float], radius: float, kind: str) -> trimesh.Trimesh:
    """A square, round, octagonal, tapered or (where it is upright) turned leg."""
    if kind == "turned":
        heights = np.linspace(foot[1], top[1], 12)
        swell = 1 + 0.45 * np.sin(np.linspace(0, rng.uniform(3, 14), 12)) * (heights < 0.8 * top[1])
        return lathe(
            [(radius * s, h) for s, h in zip(swell, heights, strict=True)], 0.5 * (top[0] + foot[0]), top[2]
        )
    taper = {"tapered": 0.5, "flared": 1.3, "club": 0.7}.get(kind, 1.0)
    sections = {"round": 12, "club": 12, "octagonal": 8}.get(kind, 4)
    if kind == "club":
        path = np.linspace(top, foot, 6)
        return tube(path, [radius * swell for swell in (0.6, 0.8, 1.1, 1.3, 1.2, 0.7)], sections=sections)
    return rod(top, foot, radius, radius * taper, sections)


def leg_kind(rng: Generator, chunky: bool = False) -> str:
    """A section for all legs of a piece."""
    kinds = ["square", "round", "octagonal", "tapered", "flared", "club", "turned"]
    return str(rng.choice(kinds, p=[0.4, 0.05, 0.1, 0.2, 0.2, 0.05, 0.0] if chunky else _LEG_SHARES))


def corner_legs(
    rng: Generator,
    x: float,
    z: float,
    y: float,
    radius: float,
    chunky: bool = False,
    splay: float | None = None,
) -> tuple[Parts, float]:
    """Four legs under (+-x, +-z), and by how much they spread on the floor; the rear pair may lean more."""
    kind = leg_kind(rng, chunky)
    spread = float(rng.uniform(0, 0.12) * (rng.random() < 0.5)) if splay is None else splay
    spread *= min(1.0, y / 0.45)
    rear = spread * rng.uniform(0.5, 2.0) if rng.random() < 0.3 else spread
    if kind == "turned":
        spread = rear = 0.0
    parts = []
    for side, lean in ((-1, spread), (1, rear)):
        foot = [x * (1 + (spread > 0) * spread * 2), 0.0, side * (z + lean)]
        parts.append(leg(rng, [x, y, side * z], foot, radius, kind))
    return mirrored(parts), spread


def floor_reach(x: float, z: float, spread: float, share: float) -> tuple[float, float]:
    """Where the legs of `corner_legs` are at a share of their height from the top."""
    return x * (1 + 2 * spread * share), z + spread * share


def rails(rng: Generator, x: float, z: float, y: float, spread: float, radius: float) -> Parts:
    """Stretchers: an H, a ring, sides at two heights, or crosses between the legs of either side."""
    kind = rng.choice(["h", "ring", "double", "cross", "middle"])
    share = rng.uniform(0.45, 0.85)
    a, b = floor_reach(x, z, spread, share)
    low = y * (1 - share)
    sections = int(rng.choice([4, 4, 12]))
    sides = mirrored([rod([a, low, -b], [a, low, b], radius, sections=sections)])
    if kind == "h":
        return [*sides, rod([-a, low, 0], [a, low, 0], radius, sections=sections)]
    ends = [rod([-a, low, s * b], [a, low, s * b], radius, sections=sections) for s in (-1, 1)]
    if kind == "ring":
        return sides + ends
    if kind == "middle":
        return [*sides, ends[0]]
    c, d = floor_reach(x, z, spread, 0.15)
    if kind == "double":
        high = y * 0.85
        return sides + ends + mirrored([rod([c, high, -d], [c, high, d], radius, sections=sections)])
    bars = [rod([c, y * 0.85, -s * d], [a, low, s * b], 0.8 * radius, sections=sections) for s in (-1, 1)]
    return sides + mirrored(bars)


def plate(rng: Generator, width: float, depth: float, y: float) -> tuple[Parts, float]:
    """A top whose corners are sharp enough for legs under them, and the height of its underside."""
    t = rng.uniform(0.01, 0.06)
    shape = outline(width, depth, float(rng.choice([14.0, 30.0, 60.0])))
    return [slab(shape, y - t, y, t * rng.uniform(0, 0.4))], y - t


def sled(rng: Generator, x: float, z: float, y: float, radius: float) -> Parts:
    """A closed bent tube on either side, joined under the seat or at the floor."""
    bend, lean = rng.uniform(0.01, 0.07), rng.uniform(0.8, 1.25)
    sections = int(rng.choice([4, 12, 12]))
    knots = [[x, y, 0], [x, y, -z], [x, radius, -z * lean], [x, radius, z * lean], [x, y, z], [x, y, 0]]
    parts = mirrored([tube(smooth_path(knots, bend), radius, sections=sections)])
    for s in (-1, 1):
        height = rng.choice([y, radius, y * 0.4])
        depth = s * z * (1 + (lean - 1) * (1 - height / y))
        parts.append(rod([-x, height, depth], [x, height, depth], radius, sections=sections))
    return parts


def cantilever(rng: Generator, x: float, z: float, y: float, radius: float) -> Parts:
    """Tubes from under the seat to its front, down, and back along the floor."""
    bend, foot = rng.uniform(0.03, 0.1), z * rng.uniform(0.7, 1.2)
    knots = [[x, y, z], [x, y, -z], [x, radius, -z * rng.uniform(0.8, 1.1)], [x, radius, foot]]
    parts = mirrored([tube(smooth_path(knots, bend), radius)])
    return [*parts, *[rod([-x, a, b], [x, a, b], radius) for a, b in ((radius, foot), (y, 0.5 * z))]]


def column(rng: Generator, y: float, reach: float, turned: bool = False) -> Parts:
    """A post on a round or square plate, or a turned baluster."""
    r = rng.uniform(0.08, 0.35) * reach
    if turned:
        steps = np.sort(rng.uniform(0.25, 0.95, 3)) * y
        profile = [(reach, 0), (reach, 0.1 * y), (0.75 * reach, 0.1 * y), (0.6 * reach, 0.2 * y)]
        profile += [(r * rng.uniform(0.6, 2.0), float(h)) for h in steps]
        return [lathe([*profile, (1.3 * r, y)])]
    plate = slab(outline(2 * reach, 2 * reach, float(rng.choice([2.0, 20.0]))), 0, rng.uniform(0.02, 0.07))
    cone = lathe([(reach * 0.7, 0.01), (r, rng.uniform(0.04, 0.12)), (r, y)])
    return [plate, cone]


_LEG_SHARES = [0.25, 0.25, 0.05, 0.25, 0.05, 0.05, 0.1]
