"""Mesh files of any folder, brought to the canonical frame."""

from pathlib import Path

import numpy as np
import trimesh

from factors import checks
from objgraph.errors import PriorError
from objgraph.geometry.mesh_data import parse_mesh
from objgraph.priors.categories import plain


class MeshError(PriorError):
    """A mesh that cannot be read or is no solid: it is left out, and nothing else is wrong."""


class MeshTimeoutError(MeshError):
    """One that would not be closed in time, on this machine and with what else it did."""


SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb")
"""Formats that a folder is searched for."""


def list_meshes(folder: Path, category: str) -> list[str]:
    """Mesh files in a folder at any depth, relative to it; only those below a subfolder of the category, however it is spelt, if any.

    Raises:
        PriorError: a name is no Unicode: no card could hold it.
    """
    own = [each for each in folder.glob("*") if plain(each.name) == plain(category) and each.is_dir()]
    return sorted(
        checks.string("the mesh file", str(path.relative_to(folder)), PriorError)
        for each in own or [folder]
        for path in each.rglob("*")
        if path.suffix.lower() in SUFFIXES and path.is_file()
    )


def read_mesh(path: Path) -> trimesh.Trimesh:
    """A file's mesh as it is.

    Raises:
        MeshError: the file cannot be read as a mesh, or holds no faces.
    """
    try:
        return parse_mesh(path.read_bytes(), path.suffix.lower().removeprefix("."))
    except (OSError, ValueError) as error:
        raise MeshError(f"{path} cannot be read as a mesh: {error}") from error


def canonical(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    """A mesh centred on its bounding box, scaled to a diagonal of 1, without colours and textures.

    Its axes are taken to be the canonical ones: y up, front at -z.

    Raises:
        MeshError: a vertex is not finite, or the mesh has no extent.
    """
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    if not (np.isfinite(used).all() and diagonal > 0):
        raise MeshError(f"{name} has vertices that are not finite, or no extent")
    mesh = trimesh.Trimesh((vertices - (low + high) / 2) / diagonal, faces, process=False)
    if not mesh.is_watertight:
        # STL and textured files repeat vertices along seams
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh
