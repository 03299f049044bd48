"""CAD meshes of a user's folder as furniture: which there are, what size and symmetry each has."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.errors import DatasetError, PriorError
from objgraph.geometry.symmetry import SAME, turn_gaps
from objgraph.synthetic.furniture import Furniture
from objgraph.training.meshes.files import SUFFIXES, canonical, list_meshes, read_mesh
from objgraph.training.meshes.index import HELDOUT_SHARE, heldout_groups, read_index
from objgraph.training.size import USUAL

log = logging.getLogger(__name__)

ShapeSet = Literal["families", "cad", "everyday"]
"""The benchmark's own families; people's meshes; a generator's. No prior is trained on any."""

_HEIGHT_M = {"chair": (0.78, 1.0), "table": (0.45, 0.76)}
_DIAGONAL_M = {"chair": (0.8, 1.5), "table": (0.6, 2.1)}


@dataclass(frozen=True)
class CadShape:
    """A mesh file to make a piece of."""

    path: Path
    diagonal_m: float | None = None
    """Of the real thing, where that is known: not a size typical of its kind."""


def choose_shapes(
    folder: Path, category: str, shapes: ShapeSet, count: int, rng: Generator
) -> list[CadShape]:
    """The shapes of `count` objects: a shuffle of those that can be read, from its start again when it ends.

    With an equal generator a longer list begins with a shorter one. A file that cannot be read is left out with
    a warning. Of a folder with an `index.json` only what is held out from training, made by people or by a generator;
    of another every mesh file in the category's subfolder.

    Raises:
        DatasetError: there is no such subfolder or no such mesh.
    """
    own = folder / category
    if not own.is_dir():
        raise DatasetError(
            f"{own}: no such folder; the meshes of each category lie in a subfolder of its name"
        )
    listed = _listed(folder, category, shapes)
    chosen: list[CadShape] = []
    for i in rng.permutation(len(listed)):
        if len(chosen) == count:
            break
        try:
            read_piece(category, listed[i].path)
        except PriorError as error:
            log.warning("a mesh is left out of the benchmark: %s", error)
            continue
        chosen.append(listed[i])
    if not chosen:
        raise DatasetError(
            f"{own}: none of its {len(listed)} mesh files ({', '.join(SUFFIXES)}) of the set '{shapes}' can be read"
        )
    return [chosen[i % len(chosen)] for i in range(count)]


def _listed(folder: Path, category: str, shapes: ShapeSet) -> list[CadShape]:
    if not (folder / "index.json").is_file():
        return [CadShape(folder / name) for name in list_meshes(folder, category)]
    try:
        meshes = read_index(folder, category)
    except PriorError as error:
        raise DatasetError(str(error)) from error
    held = heldout_groups(meshes, HELDOUT_SHARE)
    if (maker := {"cad": "people", "everyday": "generator"}.get(shapes)) is None:
        raise DatasetError(f"{folder}: its meshes are no {shapes}: say which, --shapes cad or everyday")
    return [
        CadShape(
            folder / mesh.file,
            None if mesh.size is None or mesh.typical else float(np.linalg.norm(mesh.size)),
        )
        for mesh in meshes
        if mesh.maker == maker and mesh.group in held
    ]


def read_piece(category: str, path: Path) -> trimesh.Trimesh:
    """A file's mesh in the canonical frame. Raises `PriorError` when it cannot be read."""
    return canonical(read_mesh(path), str(path))


def mesh_furniture(category: str, path: Path, rng: Generator, diagonal_m: float | None = None) -> Furniture:
    """A file's mesh as a piece of its own size, or of one that such furniture has.

    Raises `PriorError` when it cannot be read.
    """
    mesh = read_piece(category, path)
    if category in _HEIGHT_M:
        height = rng.uniform(*_HEIGHT_M[category])
        drawn = float(np.clip(height / max(mesh.extents[1], 1e-3), *_DIAGONAL_M[category]))
    else:
        usual, spread = USUAL[category]
        drawn = float(usual * np.exp(spread * np.clip(rng.normal(), -2, 2)))
    diagonal = drawn if diagonal_m is None else diagonal_m
    return Furniture(category, path.stem, mesh, diagonal, symmetry_of(mesh))


def symmetry_of(mesh: trimesh.Trimesh) -> int:
    """How many turns about y, up to twelve, leave a canonical mesh the same; 0 for all."""
    if (turn_gaps(mesh, np.radians([25, 45, 90, 180])) < SAME).all():
        return 0
    orders = np.arange(12, 1, -1)
    same = orders[turn_gaps(mesh, 2 * np.pi / orders) < SAME]
    return int(same[0]) if len(same) else 1
