"""Solids cut at a height, and closed again."""

from functools import lru_cache

import numpy as np
import trimesh

from objgraph.geometry.meshes import signed_volume
from objgraph.training.meshes.files import MeshError
from objgraph.training.meshes.solid import Shell, Solid, SolidDistance


@lru_cache(maxsize=512)
def half_of(solid: Solid, height: float, upper: bool) -> Solid:
    """What is above (below) a height, closed parts closed again; remembered for every solid.

    Raises:
        MeshError: a closed part cannot be cut; the message names the solid.
    """
    closed = [_trimmed(mesh, height, upper, solid.name) for mesh in solid.closed]
    shells = [_trimmed_shell(shell, height, upper, solid.name) for shell in solid.shells]
    sheets = [_sliced(mesh, height, upper) for mesh in solid.sheets]
    return Solid(
        solid.name,
        tuple(mesh for mesh in closed if mesh is not None),
        tuple(shell for shell in shells if shell is not None),
        tuple(mesh for mesh in sheets if mesh is not None),
    )


def _trimmed(mesh: trimesh.Trimesh, height: float, upper: bool, name: str) -> trimesh.Trimesh | None:
    """A closed mesh's half, capped; None where nothing is left.

    Raises:
        MeshError: the mesh's edges do not each join two faces.
    """
    import manifold3d

    side = 1.0 if upper else -1.0
    low, high = mesh.bounds[:, 1]
    if (low >= height) if upper else (high <= height):
        return mesh
    if (high <= height) if upper else (low >= height):
        return None
    if not mesh.is_winding_consistent:
        mesh = mesh.copy()
        trimesh.repair.fix_winding(mesh)
    faces = mesh.faces if signed_volume(mesh) > 0 else mesh.faces[:, ::-1]
    body = manifold3d.Manifold(
        manifold3d.Mesh64(
            np.ascontiguousarray(mesh.vertices, np.float64), np.ascontiguousarray(faces, np.uint64)
        )
    )
    if body.status() != manifold3d.Error.NoError:
        raise MeshError(f"{name} cannot be cut: {body.status().name}")
    half = body.trim_by_plane((0.0, side, 0.0), side * height)
    if half.is_empty():
        return None
    result = half.to_mesh64()
    return trimesh.Trimesh(result.vert_properties[:, :3], result.tri_verts.astype(np.int64), process=False)


def _trimmed_shell(shell: Shell, height: float, upper: bool, name: str) -> Shell | None:
    """A shell's half: the cap of its watertight surface closes the original, the stand-off kept everywhere."""
    points = trimesh.sample.sample_surface(shell.original, 1000, seed=0)[0]
    stand_off = -float(np.median(SolidDistance(Solid(name, (shell.watertight,)))(points)))
    at = height - stand_off if upper else height + stand_off
    original = _sliced(shell.original, height, upper)
    watertight = _trimmed(shell.watertight, at, upper, name)
    if original is None or watertight is None:
        return None
    cap = np.flatnonzero((np.abs(watertight.triangles[:, :, 1] - at) < 1e-7).all(1))
    if len(cap) == 0 or watertight is shell.watertight:
        return Shell(watertight, original)
    lid = trimesh.Trimesh(watertight.vertices + [0, height - at, 0], watertight.faces[cap], process=False)
    lid.remove_unreferenced_vertices()
    return Shell(watertight, trimesh.util.concatenate([original, lid]))  # pyright: ignore[reportArgumentType]


def _sliced(mesh: trimesh.Trimesh, height: float, upper: bool) -> trimesh.Trimesh | None:
    """The faces above (below) a height, those across it cut; None where nothing is left."""
    vertices, faces = trimesh.intersections.slice_faces_plane(
        mesh.vertices, mesh.faces, np.array([0, 1 if upper else -1, 0]), np.array([0, height, 0])
    )[:2]
    half = trimesh.Trimesh(vertices, faces, process=False)
    return half if len(faces) and half.area > 1e-7 else None
