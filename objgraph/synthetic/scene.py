"""A furnished room: which pieces stand where, and the walls and floor about them."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.errors import DatasetError
from objgraph.geometry.frames import transformed
from objgraph.synthetic.furniture import FAMILIES, Category, Furniture, make_furniture

_SEAT_TRIES = 400
_FREE_TRIES = 2000
_GAP_M = 0.05
_MIDDLE = 0.06  # shares of the room's half extents
_NEAR_SIDE = 0.3
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # object y up to world z up


@dataclass(frozen=True)
class RoomConfig:
    """What stands in the room. The world's z axis points up, the floor is z = 0."""

    chairs: int = 4
    """Number of chairs; all but the last stand about the first table."""
    tables: int = 2
    """Number of tables; the first stands in the middle."""
    walls: int = 3
    """Number of walls, 0 to 4, in the order +y, -x, +x, -y."""
    size_m: tuple[float, float] = (5.2, 5.0)
    """Extent of the floor along x and y."""
    stretch: float = 0.05
    """Standard deviation of the sizes' deviation from the family's proportions, per axis."""


@dataclass(frozen=True)
class PlacedFurniture:
    """A piece with p_world = T_world_object (scale * p_object)."""

    piece: Furniture
    T_world_object: Float[np.ndarray, "4 4"]
    scale: Float[np.ndarray, "3"]

    @property
    def p_world(self) -> Float[np.ndarray, "v 3"]:
        p_metric = self.scale * self.piece.mesh.vertices
        return transformed(self.T_world_object, p_metric)

    @property
    def footprint(self) -> Float[np.ndarray, "4 2"]:
        """Corners of the oriented box, seen from above, widened by the gap kept to others."""
        half = self.scale * self.piece.mesh.extents / 2 + _GAP_M / 2
        corners = np.array([[x, 0.0, z] for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * half
        return transformed(self.T_world_object, corners)[:, :2]


def furnish(config: RoomConfig, rng: np.random.Generator) -> list[PlacedFurniture]:
    """The first table in the middle, chairs facing it, then the rest where there is room; no two boxes touch.

    Raises `DatasetError` when the room is too small for what it is to hold.
    """
    tables = _pieces("table", config.tables, rng)
    chairs = _pieces("chair", config.chairs, rng)
    guests = max(len(chairs) - 1, 0) if tables else 0
    placed: list[PlacedFurniture] = []
    for piece in tables[:1]:
        placed.append(_settle(piece, placed, config, rng, in_middle=True))
    for index, piece in enumerate(chairs[:guests]):
        placed.append(_seat(piece, placed, 2 * np.pi * index / guests, config, rng))
    for piece in tables[1:] + chairs[guests:]:
        placed.append(_settle(piece, placed, config, rng))
    return placed


def room_shell(config: RoomConfig, height_m: float = 2.4) -> list[trimesh.Trimesh]:
    """The floor, then the walls."""
    x, y = config.size_m[0] / 2, config.size_m[1] / 2
    thin = 0.05
    walls = [
        ((-x, y, 0), (x, y + thin, height_m)),
        ((-x - thin, -y, 0), (-x, y, height_m)),
        ((x, -y, 0), (x + thin, y, height_m)),
        ((-x, -y - thin, 0), (x, -y, height_m)),
    ]
    slabs = [((-x, -y, -thin), (x, y, 0)), *walls[: config.walls]]
    return [trimesh.creation.box(bounds=slab) for slab in slabs]


def overlap(a: Float[np.ndarray, "4 2"], b: Float[np.ndarray, "4 2"]) -> bool:
    """Whether two rectangles share a point: no side of either separates them."""
    for corners in (a, b):
        for axis in (corners[1] - corners[0], corners[3] - corners[0]):
            p, q = a @ axis, b @ axis
            if p.max() < q.min() or q.max() < p.min():
                return False
    return True


def _pieces(category: Category, count: int, rng: np.random.Generator) -> list[Furniture]:
    """Every family once before any comes twice."""
    families = FAMILIES[category]
    order = np.concatenate([rng.permutation(len(families)) for _ in range(count // len(families) + 1)])
    pieces = [make_furniture(category, families[i], rng) for i in order[:count]]
    # chairs gather about the highest table
    return sorted(pieces, key=_height, reverse=True) if category == "table" else pieces


def _height(piece: Furniture) -> float:
    return piece.diagonal_m * float(piece.mesh.extents[1])


def _settle(
    piece: Furniture,
    placed: list[PlacedFurniture],
    config: RoomConfig,
    rng: np.random.Generator,
    in_middle: bool = False,
) -> PlacedFurniture:
    """Somewhere free: in the middle, or about it but not at the -y side, from where the camera looks."""
    scale = _draw_scale(piece, config, rng)
    half = np.array(config.size_m) / 2
    low, high = (-_MIDDLE * half, _MIDDLE * half) if in_middle else (-half * [1, _NEAR_SIDE], half)
    for _ in range(_FREE_TRIES):
        candidate = stand(piece, scale, rng.uniform(low, high), rng.uniform(-np.pi, np.pi))
        if _free(candidate, placed, config):
            return candidate
    raise _no_room(piece, config)


def _seat(
    piece: Furniture,
    placed: list[PlacedFurniture],
    bearing: float,
    config: RoomConfig,
    rng: np.random.Generator,
) -> PlacedFurniture:
    """Facing the first table, as near to it as comes free along the bearing."""
    scale = _draw_scale(piece, config, rng)
    table = placed[0].T_world_object
    bearing += np.arctan2(table[1, 0], table[0, 0]) + rng.normal(0, 0.15)
    turn = rng.normal(0, 0.2)
    for distance in np.linspace(0.3, 2.0, _SEAT_TRIES):
        out = np.array([np.cos(bearing), np.sin(bearing)])
        # at yaw 0 the front, -z, looks along world +y
        candidate = stand(piece, scale, table[:2, 3] + distance * out, bearing + np.pi / 2 + turn)
        if _free(candidate, placed, config):
            return candidate
    raise _no_room(piece, config)


def _draw_scale(piece: Furniture, config: RoomConfig, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    stretch = 1 + np.clip(rng.normal(0, config.stretch, 3), -3 * config.stretch, 3 * config.stretch)
    if piece.symmetry in (0, 4):
        stretch[2] = stretch[0]
    return piece.diagonal_m * stretch


def stand(piece: Furniture, scale: np.ndarray, at: np.ndarray, yaw: float) -> PlacedFurniture:
    """The piece on the floor at (x, y), turned by `yaw` about z; at 0 its front looks along +y."""
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ _UPRIGHT
    T[:3, 3] = [*at, -scale[1] * piece.mesh.bounds[0, 1]]
    return PlacedFurniture(piece, T, scale)


def _free(candidate: PlacedFurniture, placed: list[PlacedFurniture], config: RoomConfig) -> bool:
    corners = candidate.footprint
    inside = np.all(np.abs(corners) <= np.array(config.size_m) / 2)
    return bool(inside) and not any(overlap(corners, other.footprint) for other in placed)


def _no_room(piece: Furniture, config: RoomConfig) -> DatasetError:
    return DatasetError(
        f"no place for the {piece.family} {piece.category} in a room of {config.size_m} m with "
        f"{config.chairs} chairs and {config.tables} tables: ask for fewer pieces or a larger room"
    )
