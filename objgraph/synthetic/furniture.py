"""Furniture of families that no prior of this project was trained on: the objects of the sample scene."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh

from objgraph.synthetic.chairs import CHAIRS
from objgraph.synthetic.tables import TABLES

Category = Literal["chair", "table"]
FAMILIES: dict[str, tuple[str, ...]] = {"chair": tuple(CHAIRS), "table": tuple(TABLES)}


@dataclass(frozen=True)
class Furniture:
    """One piece, in its canonical frame."""

    category: str
    family: str
    mesh: trimesh.Trimesh
    """Canonical: y up, front at -z, bounding box centred, its diagonal 1. Closed parts that may overlap."""
    diagonal_m: float
    """Diagonal of the bounding box of the real piece, metres."""
    symmetry: int
    """Rotations about y that leave it the same: 1, 2, 4, or 0 for every angle."""


def make_furniture(category: Category, family: str, rng: np.random.Generator) -> Furniture:
    """A piece of one of `FAMILIES[category]` with dimensions drawn from `rng`.

    Raises `KeyError` for a family that is not there.
    """
    if category == "chair":
        mesh, symmetry = CHAIRS[family](rng), 1
    else:
        mesh, symmetry = TABLES[family](rng)
    low, high = mesh.bounds
    diagonal = float(np.linalg.norm(high - low))
    canonical = trimesh.Trimesh((mesh.vertices - (low + high) / 2) / diagonal, mesh.faces, process=False)
    return Furniture(category, family, canonical, diagonal, symmetry)
