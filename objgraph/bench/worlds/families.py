"""Furniture families of the benchmark: no prior was trained on them, and the sample scene has none of them."""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.bench.worlds import garden_chairs, house_chairs
from objgraph.bench.worlds.tables import TABLES
from objgraph.synthetic.furniture import Category, Furniture
from objgraph.training.meshes.files import canonical

CHAIRS: dict[str, Callable[[Generator], trimesh.Trimesh]] = {
    "adirondack": garden_chairs.adirondack,
    "klismos": house_chairs.klismos,
    "director": garden_chairs.director,
    "rocker": house_chairs.rocker,
    "monobloc": garden_chairs.monobloc,
    "barrel": house_chairs.barrel,
    "board": house_chairs.board,
    "deck": garden_chairs.deck,
}
FAMILIES: dict[Category, tuple[str, ...]] = {"chair": tuple(CHAIRS), "table": tuple(TABLES)}


def make_piece(category: Category, family: str, rng: Generator) -> Furniture:
    """A piece of one of `FAMILIES[category]` with dimensions drawn from `rng`.

    Raises `KeyError` for a family that is not there.
    """
    mesh, symmetry = (CHAIRS[family](rng), 1) if category == "chair" else TABLES[family](rng)
    diagonal = float(np.linalg.norm(mesh.extents))
    return Furniture(category, family, canonical(mesh, family), diagonal, symmetry)
