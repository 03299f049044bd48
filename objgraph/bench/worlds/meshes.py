"""CAD meshes of a user's folder as furniture: which there are, what size and symmetry each has."""

import logging
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh
from numpy.random import Generator

from objgraph.errors import DatasetError, PriorError
from objgraph.synthetic.furniture import Category, Furniture
from objgraph.training.mesh_files import SUFFIXES, canonical, list_meshes, read_mesh

log = logging.getLogger(__name__)

_HEIGHT_M: dict[Category, tuple[float, float]] = {"chair": (0.78, 1.0), "table": (0.45, 0.76)}
_DIAGONAL_M: dict[Category, tuple[float, float]] = {"chair": (0.8, 1.5), "table": (0.6, 2.1)}
_SAME = 0.02
"""Distance, in diagonals, within which 98 % of a shape turned about y must lie of itself to count as the same."""


def choose_meshes(folder: Path, category: Category, count: int, rng: Generator) -> list[Path]:
    """The files of `count` objects: a shuffle of those that can be read, from its start again when it ends.

    With an equal generator a longer list begins with a shorter one. A file that cannot be read is left out with
    a warning. Raises `DatasetError` when the folder has no subfolder of the category, or no mesh there.
    """
    own = folder / category
    if not own.is_dir():
        raise DatasetError(
            f"{own}: no such folder; the meshes of each category lie in a subfolder of its name"
        )
    names = list_meshes(folder, category)
    chosen: list[Path] = []
    for i in rng.permutation(len(names)):
        if len(chosen) == count:
            break
        try:
            read_piece(category, folder / names[i])
        except PriorError as error:
            log.warning("a mesh is left out of the benchmark: %s", error)
            continue
        chosen.append(folder / names[i])
    if not chosen:
        raise DatasetError(f"{own}: none of its {len(names)} mesh files ({', '.join(SUFFIXES)}) can be read")
    return [chosen[i % len(chosen)] for i in range(count)]


def read_piece(category: Category, path: Path) -> trimesh.Trimesh:
    """A file's mesh in the canonical frame. Raises `PriorError` when it cannot be read."""
    return canonical(read_mesh(path), str(path))


def mesh_furniture(category: Category, path: Path, rng: Generator) -> Furniture:
    """A file's mesh as a piece of a size that such furniture has. Raises `PriorError` when it cannot be read."""
    mesh = read_piece(category, path)
    height = rng.uniform(*_HEIGHT_M[category])
    diagonal = float(np.clip(height / max(mesh.extents[1], 1e-3), *_DIAGONAL_M[category]))
    return Furniture(category, path.stem, mesh, diagonal, symmetry_of(mesh))


def symmetry_of(mesh: trimesh.Trimesh, samples: int = 3000) -> int:
    """Scan2CAD's class of a canonical mesh: turns about y that leave it the same; 1, 2, 4, or 0 for all."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    points = np.asarray(trimesh.sample.sample_surface(mesh, samples, seed=0)[0])

    def same(degrees: float) -> bool:
        turn = trimesh.transformations.rotation_matrix(np.radians(degrees), [0, 1, 0])[:3, :3]
        gap = scene.compute_distance((points @ turn.T).astype(np.float32)).numpy()
        return bool(np.percentile(gap, 98) < _SAME)

    if all(same(angle) for angle in (25, 45, 90, 180)):
        return 0
    return next((order for order in (4, 2) if same(360 / order)), 1)
