"""Part swaps: the seat and back of one chair on the base of another, a table's top on another's base."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator
from scipy import ndimage

from objgraph.errors import PriorError
from objgraph.training.meshes.cut_solid import half_of
from objgraph.training.meshes.files import MeshError
from objgraph.training.meshes.solid import Shell, Solid, SolidDistance, check_sign

PITCH = 1 / 72
"""Edge of the cells in which solids are looked at, in canonical units."""

_SEAT_RANGE = {"chair": (0.2, 1.0), "table": (0.5, 1.0)}
_THICKEST = {"chair": 0.16, "table": 0.14}
_STRETCH = 2.2
"""Largest change of a base's width or depth."""
_ANISOTROPY = 1.8
_LOOSE_SHARE = 0.03

SWAPPED = tuple(_SEAT_RANGE)
"""Categories whose meshes have parts to swap."""

Section = Bool[np.ndarray, "a b"]
Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Cut:
    """Where a solid is cut under its seat or top, and what meets there; seen in cells of `PITCH`."""

    height: float
    """The underside's y."""
    slab: float
    """Thickness above it."""
    low: Float[np.ndarray, "2"]
    """Lower corner (x, z) of the slab's box."""
    high: Float[np.ndarray, "2"]
    floor: float
    origin: Float[np.ndarray, "2"]
    """(x, z) of the centre of the sections' first cell."""
    plates: tuple[Section, ...]
    """Sections of the slab at a fifth to four fifths of it."""
    feet: Section
    """Section just below the underside."""
    loose: tuple[float, float]
    """Shares of the upper and the lower half that hang in the air once cut."""


def swap(top: Solid, base: Solid, category: str, rng: Generator) -> Solid:
    """What is above the underside of one solid's seat on what is below that of another, in canonical units.

    The base is scaled in x and z so that the boxes of the two slabs match, and shrunk further where its legs
    would miss the slab; the floor's distance lies at random between those of the two. Nothing but the two is
    used: whoever trains on the result passes training solids only.

    Raises:
        MeshError: a solid has no cut, or the halves do not fit; the message says why.
        PriorError: the category has no parts to swap.
    """
    above, below = find_cut(top, category), find_cut(base, category)
    name = f"{top.name}+{base.name}"
    for solid, cut, half in ((top, above, 0), (base, below, 1)):
        if cut.loose[half] > _LOOSE_SHARE:
            raise MeshError(
                f"{name}: {cut.loose[half]:.0%} of that half of {solid.name} would hang in the air"
            )
    placed = _placement(name, above, below, rng)
    upper = half_of(top, above.height, True)
    lower = _mapped(half_of(base, below.height, False), placed)
    if not upper.surfaces or not lower.surfaces:
        raise MeshError(f"{name}: nothing is left of one of the halves")
    both = Solid(
        name, upper.closed + lower.closed, upper.shells + lower.shells, upper.sheets + lower.sheets
    ).warped(lambda points: points)
    check_sign(both)
    return both


@lru_cache(maxsize=512)
def find_cut(solid: Solid, category: str) -> Cut:
    """The underside of the largest horizontal plate of a chair or table.

    Raises:
        MeshError: there is none.
        PriorError: the category has no such plate.
    """
    if category not in _SEAT_RANGE:
        raise PriorError(f"part swaps know {', '.join(_SEAT_RANGE)}, not {category!r}")
    distance = SolidDistance(solid)
    bounds = np.array([mesh.bounds for mesh in solid.surfaces])
    low, high = bounds[:, 0].min(0), bounds[:, 1].max(0)
    x, y, z = (np.arange(a + PITCH / 2, b, PITCH) for a, b in zip(low, high, strict=True))

    def sections(heights: Float[np.ndarray, "h"]) -> Bool[np.ndarray, "a h b"]:
        grid = np.stack(np.meshgrid(x, heights, z, indexing="ij"), -1)
        # cells that a thin part crosses count as its own
        return (distance(grid.reshape(-1, 3)) < 0.4 * PITCH).reshape(grid.shape[:3])

    cells = sections(y)
    area = cells.sum((0, 2))
    share = (y - low[1]) / (high[1] - low[1])
    first, last = _SEAT_RANGE[category]
    inner = (share >= first) & (share <= last)
    if not inner.any() or area[inner].max() < 0.15 * len(x) * len(z):
        raise MeshError(f"{solid.name} has no seat or top to cut it under")
    widest = area[inner].max()
    peak = int(np.flatnonzero(inner & (area >= 0.85 * widest))[-1])
    under = _underside(peak, y, area, _THICKEST[category] * (high[1] - low[1]), sections)
    slab = y[peak] + PITCH / 2 - under
    plates = sections(under + slab * np.linspace(0.2, 0.8, 4))
    taken = np.argwhere(plates.any(1))
    split = int(np.searchsorted(y, under))
    return Cut(
        height=under,
        slab=slab,
        low=np.array([x[taken[:, 0].min()], z[taken[:, 1].min()]]) - PITCH / 2,
        high=np.array([x[taken[:, 0].max()], z[taken[:, 1].max()]]) + PITCH / 2,
        floor=float(low[1]),
        origin=np.array([x[0], z[0]]),
        plates=tuple(plates.transpose(1, 0, 2)),
        feet=sections(np.array([under - 0.3 * PITCH]))[:, 0],
        loose=(_loose(cells[:, split:]), _loose(cells[:, max(split - 1, 0) :: -1])),
    )


def _underside(
    peak: int,
    y: Float[np.ndarray, "h"],
    area: Float[np.ndarray, "h"],
    thickest: float,
    sections: Callable[[Float[np.ndarray, "h"]], Bool[np.ndarray, "a h b"]],
) -> float:
    """The height at which the plate about level `peak` gives way to what carries it."""
    least = 0.45 * area[peak]
    level = peak
    while level > 0 and area[level] >= least:
        if y[peak] - y[level] > thickest:
            return float(y[level])
        level -= 1
    fine = np.linspace(y[level], y[level + 1], 9)
    full = sections(fine).sum((0, 2)) >= least
    return float(fine[int(np.argmax(full))] if full.any() else fine[-1])


def _loose(cells: Bool[np.ndarray, "a h b"]) -> float:
    """Share of the cells that is not joined to the three layers at the cut, which come first."""
    labels, count = ndimage.label(cells, np.ones((3, 3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    if count == 0:
        return 1.0
    held = np.isin(labels, np.unique(labels[:, :3])) & cells
    return 1.0 - float(held.sum() / cells.sum())


def _placement(name: str, above: Cut, below: Cut, rng: Generator) -> Callable[[Points], Points]:
    """The map of the base under the top.

    Raises:
        MeshError: it would be too distorted, or its legs miss the slab.
    """
    scale = (above.high - above.low) / (below.high - below.low)
    feet = np.argwhere(below.feet)
    if len(feet) == 0:
        raise MeshError(f"{name}: nothing is under the slab of the base")
    if (np.ptp(feet, axis=0) * PITCH < 0.5 * (below.high - below.low)).all():
        # a column and its foot stay round
        scale = np.full(2, np.sqrt(scale.prod()))
    ratio = max(scale[0] / scale[1], scale[1] / scale[0])
    if scale.max() > _STRETCH or scale.min() < 1 / _STRETCH or ratio > _ANISOTROPY:
        raise MeshError(f"{name}: the base would be scaled by {scale[0]:.2f} and {scale[1]:.2f}")
    shrink, share = _contact(name, above, below, scale)
    scale = scale * shrink
    lift = share * above.slab
    legs = (above.height - above.floor, (below.height - below.floor) * np.sqrt(scale.prod()))
    blend = rng.uniform()
    reach = legs[0] ** blend * legs[1] ** (1 - blend) + lift
    factor = np.array([scale[0], reach / (below.height - below.floor), scale[1]])
    there, here = (below.low + below.high) / 2, (above.low + above.high) / 2
    source = np.array([there[0], below.height, there[1]])
    target = np.array([here[0], above.height + lift, here[1]])
    return lambda points: (points - source) * factor + target


def _contact(name: str, above: Cut, below: Cut, scale: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """The least shrinking of the base, and the share of the slab to sink it in, at which every leg meets it."""
    labels: np.ndarray
    labels, count = ndimage.label(below.feet, np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    cells = np.argwhere(below.feet)
    leg = labels[below.feet] - 1
    offset = below.origin + cells * PITCH - (below.low + below.high) / 2
    for shrink in np.arange(1.0, 0.59, -0.05):
        at = offset * scale * shrink + (above.low + above.high) / 2
        index = np.rint((at - above.origin) / PITCH).astype(int)
        for share, plate in zip(np.linspace(0.2, 0.8, 4), above.plates, strict=True):
            within = ((index >= 0) & (index < plate.shape)).all(1)
            met = np.zeros(len(index), bool)
            met[within] = plate[tuple(index[within].T)]
            if (np.bincount(leg, met, count) >= 0.85 * np.bincount(leg, minlength=count)).all():
                return float(shrink), float(share)
    raise MeshError(f"{name}: legs of the base would miss the slab")


def _mapped(solid: Solid, move: Callable[[Points], Points]) -> Solid:
    """The solid with its vertices moved and nothing else."""

    def moved(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        return trimesh.Trimesh(move(np.asarray(mesh.vertices)), mesh.faces, process=False)

    return Solid(
        solid.name,
        tuple(moved(mesh) for mesh in solid.closed),
        tuple(Shell(moved(shell.watertight), moved(shell.original)) for shell in solid.shells),
        tuple(moved(mesh) for mesh in solid.sheets),
    )
