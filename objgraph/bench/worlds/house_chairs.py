"""Chairs of living and dining rooms; metres, floor at y = 0, front at -z.

Each function draws its dimensions from the generator and returns the mesh.
"""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.bench.worlds.boards import SIDES, ring, smooth, strip
from objgraph.synthetic.parts import arc, beam, column, join, oval, sheet


def klismos(rng: Generator) -> trimesh.Trimesh:
    """Sabre legs that sweep out to the front and the back, and a broad tablet bent around the shoulders."""
    x, z = rng.uniform(0.19, 0.23), rng.uniform(0.19, 0.22)
    seat, top, lean = rng.uniform(0.43, 0.47), rng.uniform(0.8, 0.94), rng.uniform(0.1, 0.17)
    sweep, r = rng.uniform(0.09, 0.15), rng.uniform(0.018, 0.024)
    parts = [oval(x + 0.03, z + 0.02, seat - 0.03, seat + rng.uniform(0.015, 0.045), 6.0)]
    thin = np.linspace(0.6, 1, 9) * r
    for side in SIDES:
        foot, head = (side * (x + 0.03), 0, -z - sweep), (side * x, seat, -z + 0.02)
        parts.append(beam(arc(foot, (side * x, 0.52 * seat, -z + 0.01), head), thin, 4))
        heel, knee = (side * (x + 0.03), 0, z + sweep), (side * x, seat, z - 0.02)
        parts.append(beam(arc(heel, (side * x, 0.52 * seat, z - 0.01), knee), thin, 4))
        stile = arc(knee, (side * x, 0.5 * (seat + top), z + 0.3 * lean), (side * x, top, z + lean))
        parts.append(beam(stile, thin[::-1], 4))
        parts.append(beam([(side * x, seat - 0.03, -z), (side * x, seat - 0.03, z)], 0.9 * r, 4))
    height, wide, wrap = rng.uniform(0.13, 0.2), rng.uniform(1.15, 1.35), rng.uniform(0.1, 0.16)
    u, y = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(top - height, top + 0.01, 5), indexing="ij")
    share = (y - seat) / (top - seat)
    back = z + lean * share**1.7 + wrap * (1 / wide**2 - u**2)
    parts.append(sheet(np.stack([wide * x * u, y, back], axis=-1), 0.02))
    return join(parts)


def rocker(rng: Generator) -> trimesh.Trimesh:
    """A rocking chair: runners bent up at both ends, a high back of flat boards, arms on posts."""
    x, z = rng.uniform(0.23, 0.27), rng.uniform(0.2, 0.24)
    seat, top, lean = rng.uniform(0.4, 0.44), rng.uniform(1.0, 1.12), rng.uniform(0.16, 0.26)
    arm, bend, r = rng.uniform(0.6, 0.66), rng.uniform(0.9, 1.3), rng.uniform(0.016, 0.021)

    def runner(at: float) -> float:
        return 0.02 + at * at / (2 * bend)

    parts = []
    for side in SIDES:
        path = [(side * x, runner(at), at) for at in np.linspace(-z - 0.14, z + rng.uniform(0.22, 0.3), 17)]
        parts.append(beam(path, 0.02, 4))
        parts.append(beam([(side * x, runner(-z), -z), (side * x, arm, -z)], r))
        post = arc(
            (side * x, seat, z), (side * x, (seat + top) / 2, z + 0.4 * lean), (side * x, top, z + lean)
        )
        parts.append(beam([(side * x, runner(z), z), *post], r))
        back = z + 0.65 * lean * (arm - seat) / (top - seat)
        rest = [(side * (x + 0.01), arm, -z - 0.05), (side * (x + 0.01), arm, back + 0.01)]
        parts.append(strip(rest, [(0.045, 0, 0), (0.028, 0, 0)], 0.022))
        parts.append(beam([(side * x, 0.22, -z), (side * x, 0.22, z)], 0.012))
    for at in (-z, z):
        parts.append(beam([(-x, 0.2, at), (x, 0.2, at)], 0.012))
    grid = np.meshgrid(np.linspace(-x - 0.02, x + 0.02, 9), np.linspace(-z - 0.03, z, 9), indexing="ij")
    hollow = 0.025 * (1 - (grid[0] / (x + 0.02)) ** 2)
    parts.append(sheet(np.stack([grid[0], seat - hollow - 0.06 * (grid[1] + z), grid[1]], axis=-1), 0.03))
    for share in (0.12, 0.95):
        y, at = seat + share * (top - seat), z + lean * (0.6 * share + 0.4 * share**2)
        half = 0.025 if share < 0.5 else 0.045
        parts.append(strip(arc((-x, y, at), (0, y, at + 0.02), (x, y, at)), (0, half, 0.2 * half), 0.02))
    boards = int(rng.integers(4, 7))
    for u in np.linspace(-0.75, 0.75, boards):
        shares = np.linspace(0.12, 0.95, 6)
        path = [
            (u * x, seat + s * (top - seat), z + lean * (0.6 * s + 0.4 * s * s) + 0.018 * (1 - u * u))
            for s in shares
        ]
        parts.append(strip(path, (0.55 * x / boards, 0, 0), 0.012))
    return join(parts)


def board(rng: Generator) -> trimesh.Trimesh:
    """A peasant's chair of boards: a cut-out board in front and behind, an eight-cornered seat, one back board."""
    radius, seat = rng.uniform(0.21, 0.24), rng.uniform(0.43, 0.47)
    top, lean = rng.uniform(0.84, 1.0), rng.uniform(0.1, 0.18)
    splay, thick = rng.uniform(0.04, 0.09), rng.uniform(0.026, 0.036)
    wide, waist = rng.uniform(0.15, 0.19), rng.uniform(0.06, 0.09)
    parts = [column(radius, seat - 0.035, seat, 8, np.pi / 8)]
    share = np.linspace(0, 1, 11)
    outline = waist + (wide - waist) * np.abs(2 * share - 1) ** 1.5
    for side in SIDES:
        z = side * (0.6 * radius + splay * (1 - share))
        path = np.column_stack([0 * share, share * (seat - 0.02), z])
        parts.append(strip(path, np.column_stack([outline, 0 * share, 0 * share]), thick))
    reach = 0.6 * radius + 0.6 * splay
    parts.append(beam([(0, 0.4 * seat, -reach), (0, 0.4 * seat, reach)], 0.02, 4))
    neck, crest = rng.uniform(0.05, 0.08), rng.uniform(0.15, 0.2)
    knots = np.array([[1.3 * neck, 0], [neck, 0.2], [0.9 * crest, 0.6], [crest, 0.8], [0.35 * crest, 1.0]])
    profile = smooth(np.column_stack([knots, np.zeros(5)]), 19)
    rise = profile[:, 1]
    path = np.column_stack([0 * rise, seat - 0.02 + rise * (top - seat + 0.02), 0.72 * radius + lean * rise])
    parts.append(strip(path, np.column_stack([profile[:, 0], 0 * rise, 0 * rise]), 0.85 * thick))
    return join(parts)


def barrel(rng: Generator) -> trimesh.Trimesh:
    """A round cushion within a fence of upright slats between a ring on the floor and a sloping rim."""
    radius, seat = rng.uniform(0.27, 0.31), rng.uniform(0.42, 0.46)
    top, arm = rng.uniform(0.77, 0.88), rng.uniform(0.6, 0.68)
    sweep, flare = np.deg2rad(rng.uniform(200, 250)), rng.uniform(1.0, 1.12)
    r = rng.uniform(0.016, 0.022)

    def on_rim(angle: float) -> np.ndarray:
        y = arm + (top - arm) * np.cos(np.clip(angle / sweep, -0.5, 0.5) * np.pi) ** 2
        return np.array([flare * radius * np.sin(angle), y, flare * radius * np.cos(angle)])

    parts = [ring((radius, radius), r, r), ring((radius, radius), seat - 0.09, 0.8 * r)]
    parts.append(beam([on_rim(a) for a in np.linspace(-sweep / 2, sweep / 2, 33)], 1.2 * r, 8))
    parts.append(oval(radius, radius, seat - 0.1, seat - 0.07))
    parts.append(oval(0.94 * radius, 0.94 * radius, seat - 0.08, seat))
    for angle in np.linspace(-sweep / 2, sweep / 2, int(rng.integers(15, 23))):
        foot = np.array([radius * np.sin(angle), 0, radius * np.cos(angle)])
        knee = foot + [0, seat - 0.1, 0]
        tangent = np.array([np.cos(angle), 0, -np.sin(angle)])
        parts.append(strip([foot, knee, on_rim(angle)], 0.016 * tangent, 0.014))
    for angle in (np.pi - 0.45, np.pi + 0.45):
        foot = np.array([radius * np.sin(angle), 0, radius * np.cos(angle)])
        parts.append(beam([foot, foot + [0, seat - 0.08, 0]], 1.1 * r, 8))
    return join(parts)
