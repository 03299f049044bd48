"""Backrests that chairs of several families share."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.families.parts import box, mirrored, panel, rod, smooth_path, tube

Parts = list[trimesh.Trimesh]


def backrest(rng: Generator, width: float, y: float, reach: float, z: float, tilt: float) -> Parts:
    """One of the backs, rising `reach` from height `y` at depth `z` and leaning by `tilt` radians to +z."""
    kind = rng.choice(["solid", "floating", "ladder", "slats", "spindles", "frame", "hoop"], p=_SHARES)
    return _KINDS[kind](rng, width, y, reach, z, np.tan(tilt))


def _solid(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    v = np.linspace(0, 1, 7)
    top = rng.uniform(0.7, 1.08)
    round_top = np.where(v > 0.85, 1 - rng.uniform(0, 0.25), 1.0)
    widths = width * (1 + (top - 1) * v) * round_top
    return [
        panel(widths, y + reach * v, z + slope * reach * v, rng.uniform(0.012, 0.07), rng.uniform(0, 0.06))
    ]


def _floating(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    """A panel held above the seat by two posts."""
    start = rng.uniform(0.25, 0.7)
    v = np.linspace(start, 1, 5)
    thickness = rng.uniform(0.012, 0.05)
    parts = [panel(np.full(5, width), y + reach * v, z + slope * reach * v, thickness, rng.uniform(0, 0.05))]
    x, r = width * rng.uniform(0.25, 0.47), rng.uniform(0.008, 0.018)
    top = start + 0.2
    return parts + mirrored([rod([x, y, z], [x, y + reach * top, z + slope * reach * top], r)])


def _posts(width: float, y: float, reach: float, z: float, slope: float, r: float) -> Parts:
    x = width / 2 - r
    return mirrored([rod([x, y, z], [x, y + reach, z + slope * reach], r)])


def _ladder(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    count = int(rng.integers(2, 6))
    height = reach / count * rng.uniform(0.25, 0.6)
    thickness, wrap = rng.uniform(0.012, 0.022), rng.uniform(0, 0.03)
    parts = _posts(width, y, reach, z, slope, rng.uniform(0.011, 0.022))
    for v in np.linspace(rng.uniform(0.2, 0.45), 1 - height / reach, count):
        ends = np.array([v, v + height / reach])
        parts.append(panel([width, width], y + reach * ends, z + slope * reach * ends, thickness, wrap))
    return parts


def _slats(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    count = int(rng.integers(2, 7))
    r = rng.uniform(0.011, 0.022)
    parts = _posts(width, y, reach, z, slope, r)
    slat = width / count * rng.uniform(0.25, 0.6)
    depth = rng.uniform(0.010, 0.02)
    length = reach / np.cos(np.arctan(slope))
    for x in np.linspace(-0.5, 0.5, count + 2)[1:-1] * width:
        centre = [x, y + reach / 2, z + slope * reach / 2]
        parts.append(box([slat, length, depth], centre, pitch=np.arctan(slope)))
    rail = np.array([1 - rng.uniform(0.08, 0.25), 1.0])
    parts.append(panel([width, width], y + reach * rail, z + slope * reach * rail, depth * 1.5))
    return parts


def _spindles(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    count, r = int(rng.integers(4, 9)), rng.uniform(0.006, 0.01)
    fan = rng.uniform(0.8, 1.15)
    parts = []
    for x in np.linspace(-0.5, 0.5, count) * width * 0.92:
        parts.append(rod([x, y, z], [x * fan, y + reach, z + slope * reach], r))
    crest = np.array([1 - rng.uniform(0.06, 0.18), 1.0])
    wide = [width * fan] * 2
    return [*parts, panel(wide, y + reach * crest, z + slope * reach * crest, rng.uniform(0.018, 0.03))]


def _frame(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    """An open frame: posts and a crest, perhaps one cross bar or an X."""
    r = rng.uniform(0.010, 0.022)
    parts = _posts(width, y, reach, z, slope, r)
    crest = np.array([1 - rng.uniform(0.06, 0.35), 1.0])
    parts.append(
        panel([width] * 2, y + reach * crest, z + slope * reach * crest, 1.6 * r, rng.uniform(0, 0.02))
    )
    x = width / 2 - r
    if rng.random() < 0.5:
        low, high = 0.15, crest[0]
        a, b = [y + reach * low, z + slope * reach * low], [y + reach * high, z + slope * reach * high]
        parts += mirrored([rod([-x, *a], [x, *b], 0.7 * r)])
    return parts


def _hoop(rng: Generator, width: float, y: float, reach: float, z: float, slope: float) -> Parts:
    """A bent hoop, open or with a smaller one or splats inside."""
    r = rng.uniform(0.009, 0.018)
    x, lean = width / 2 - r, slope * reach

    def bow(share: float) -> trimesh.Trimesh:
        knots = [[-x * share, y, z], [-x * share, y + reach * share, z + lean * share]]
        knots += [[x * share, y + reach * share, z + lean * share], [x * share, y, z]]
        return tube(smooth_path(knots, 0.3 * width), r)

    parts = [bow(1.0)]
    if rng.random() < 0.6:
        parts.append(bow(rng.uniform(0.45, 0.8)))
    else:
        parts.append(panel([width * 0.3] * 2, [y, y + reach * 0.97], [z, z + lean * 0.97], r))
    return parts


_KINDS = {
    "solid": _solid,
    "floating": _floating,
    "ladder": _ladder,
    "slats": _slats,
    "spindles": _spindles,
    "frame": _frame,
    "hoop": _hoop,
}
_SHARES = [0.32, 0.12, 0.14, 0.13, 0.08, 0.13, 0.08]
