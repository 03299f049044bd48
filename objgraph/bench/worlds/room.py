"""A room of its own for every object: floor, walls, and clutter close about the object."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from objgraph.bench.worlds.crowd import pushed_against, things_on
from objgraph.bench.worlds.desks import CARRIED, on_desk
from objgraph.bench.worlds.families import FAMILIES, make_piece
from objgraph.synthetic.faults import Faults
from objgraph.synthetic.furniture import Category, Furniture
from objgraph.synthetic.parts import join
from objgraph.synthetic.scene import PlacedFurniture, RoomConfig, overlap, room_shell, stand

Rectangle = Float[np.ndarray, "4 2"]
_TRIES = 60
_FURNITURE = 0.65
"""Share of furniture among the clutter; the rest are boxes and plants."""
_NEAR_VIEW = 0.5
"""Share of the clutter that stands on the side from which the first view looks."""


@dataclass(frozen=True)
class Room:
    """What stands where; z up, the floor is z = 0."""

    target: PlacedFurniture
    clutter: tuple[PlacedFurniture, ...]
    """Furniture about the target; the masks name it."""
    shell: tuple[trimesh.Trimesh, ...]
    """Floor, walls, and the boxes and plants that no mask names."""
    occupied: tuple[Rectangle, ...]
    """Footprints of everything that stands on the floor, the target's, or its desk's, first."""
    size_m: tuple[float, float]

    @property
    def meshes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Vertices in the room and faces of everything, the target's first."""
        pieces = [(piece.p_world, piece.piece.mesh.faces) for piece in (self.target, *self.clutter)]
        return [*pieces, *((part.vertices, part.faces) for part in self.shell)]


def draw_room(piece: Furniture, bearing: float, rng: Generator, faults: Faults | None = None) -> Room:
    """The piece near the middle at any heading, with 2 to 5 things about it, some of them towards `bearing`. Displays stand on a desk.

    `bearing`: radians about z from the target to where the first view is to be taken. With `faults` there may be things
    on it, and furniture pushed under or over it.
    """
    size = rng.uniform(4.6, 6.4, 2)
    target = stand(
        piece, draw_scale(piece, rng), rng.uniform(-0.1, 0.1, 2) * size, rng.uniform(-np.pi, np.pi)
    )
    clutter, props = [], []
    base = target
    if piece.category in CARRIED:
        target, base = on_desk(target, rng)
        clutter.append(base)
    occupied = [base.footprint]
    if faults is not None:
        if faults.pushed or faults.merged:
            other = _any_piece(rng, "table" if piece.category == "chair" else "chair")
            clutter.append(pushed_against(base, other, rng))
            occupied.append(clutter[-1].footprint)
        for thing in things_on(base, round(faults.things_on), rng):
            if base is target or not overlap(_footprint(thing), target.footprint):
                props.append(thing)
    for _ in range(int(rng.integers(2, 6))):
        mean = bearing if rng.random() < _NEAR_VIEW else rng.uniform(-np.pi, np.pi)
        if rng.random() < _FURNITURE:
            other = _any_piece(rng, "chair" if rng.random() < 0.5 else "table")
            placed = stand(other, draw_scale(other, rng), np.zeros(2), rng.uniform(-np.pi, np.pi))
            at = _free_place(placed.footprint, occupied, size, mean, rng)
            if at is not None:
                clutter.append(_moved(placed, at))
                occupied.append(placed.footprint + at)
            continue
        prop = _box(rng) if rng.random() < 0.5 else _plant(rng)
        at = _free_place(_footprint(prop), occupied, size, mean, rng)
        if at is not None:
            prop.apply_translation([*at, 0])
            props.append(prop)
            occupied.append(_footprint(prop))
    shape = RoomConfig(walls=int(rng.integers(2, 5)), size_m=(float(size[0]), float(size[1])))
    floor, *walls = room_shell(shape)
    if faults is not None:
        floor.apply_translation([0, 0, faults.floor_m])
    shell = (floor, *walls, *props)
    return Room(target, tuple(clutter), shell, tuple(occupied), shape.size_m)


def draw_scale(piece: Furniture, rng: Generator, stretch: float = 0.05) -> Float[np.ndarray, "3"]:
    """Metres per canonical unit and axis: the real size, with a deviation from the shape's proportions."""
    scale = piece.diagonal_m * (1 + stretch * np.clip(rng.normal(size=3), -2, 2))
    if piece.symmetry not in (1, 2):
        scale[2] = scale[0]
    return scale


def _any_piece(rng: Generator, category: Category) -> Furniture:
    return make_piece(category, str(rng.choice(FAMILIES[category])), rng)


def _moved(placed: PlacedFurniture, by: np.ndarray) -> PlacedFurniture:
    T_world_object = placed.T_world_object.copy()
    T_world_object[:2, 3] += by
    return PlacedFurniture(placed.piece, T_world_object, placed.scale)


def _free_place(
    footprint: Rectangle, occupied: list[Rectangle], size: np.ndarray, mean: float, rng: Generator
) -> Float[np.ndarray, "2"] | None:
    """Where a thing that stands at the origin can go: close to the target, about the bearing `mean`."""
    middle = occupied[0].mean(axis=0)
    for _ in range(_TRIES):
        angle = mean + rng.normal(0, 0.6)
        at = middle + rng.uniform(0.35, 1.7) * np.array([np.cos(angle), np.sin(angle)])
        corners = footprint + at
        if np.all(np.abs(corners) <= size / 2) and not any(overlap(corners, other) for other in occupied):
            return at
    return None


def _footprint(prop: trimesh.Trimesh, gap: float = 0.025) -> Rectangle:
    (x0, y0), (x1, y1) = prop.bounds[0, :2] - gap, prop.bounds[1, :2] + gap
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _box(rng: Generator) -> trimesh.Trimesh:
    """A cardboard box or a low cupboard."""
    half, height = rng.uniform(0.12, 0.3, 2), rng.uniform(0.25, 0.95)
    return trimesh.creation.box(bounds=[[*-half, 0], [*half, height]])


def _plant(rng: Generator) -> trimesh.Trimesh:
    """A pot with a ball of leaves or several."""
    radius, pot, height = rng.uniform(0.1, 0.17), rng.uniform(0.2, 0.35), rng.uniform(0.6, 1.3)
    parts = [trimesh.creation.cylinder(radius, segment=[[0, 0, 0], [0, 0, pot]], sections=16)]
    parts.append(trimesh.creation.cylinder(0.015, segment=[[0, 0, pot], [0, 0, height]], sections=8))
    for _ in range(int(rng.integers(3, 8))):
        leaf = trimesh.creation.icosphere(2, rng.uniform(0.06, 0.16))
        leaf.apply_translation([*rng.normal(0, 0.07, 2), rng.uniform(0.5 * (pot + height), height)])
        parts.append(leaf)
    return join(parts)
