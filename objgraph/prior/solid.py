"""Meshes of any quality as solids with a robust signed distance.

Collected CAD meshes overlap, have open shells and single sheets. Closed components are united (the least of
their signed distances); the rest is closed by `point_cloud_utils` (Huang et al., "Robust Watertight Manifold
Surface Generation Method for ShapeNet Models", 2018); what stays a sheet becomes a thin solid.
"""

import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Float

from objgraph.errors import PriorError

SHEET_HALF_THICKNESS = 0.003
"""Half the thickness given to single sheets, in canonical units: some 3 mm on a chair."""

_MAX_CLOSED_COMPONENTS = 60
_MAX_FLAT_COMPONENTS = 6
_WATERTIGHT_RESOLUTION = 10_000
_WATERTIGHT_SECONDS = 40


@dataclass(frozen=True)
class Solid:
    """A union of closed meshes and of sheets, in one frame."""

    name: str
    closed: tuple[trimesh.Trimesh, ...]
    sheets: tuple[trimesh.Trimesh, ...] = ()

    def warped(self, warp: Callable[[Float[np.ndarray, "v 3"]], Float[np.ndarray, "v 3"]]) -> "Solid":
        """The solid with its vertices moved, then centred and brought back to a box diagonal of 1."""

        def moved(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
            return trimesh.Trimesh(warp(np.asarray(mesh.vertices)), mesh.faces, process=False)

        closed, sheets = [moved(m) for m in self.closed], [moved(m) for m in self.sheets]
        bounds = np.array([m.bounds for m in closed + sheets])
        low, high = bounds[:, 0].min(0), bounds[:, 1].max(0)
        for mesh in closed + sheets:
            mesh.vertices = (mesh.vertices - (low + high) / 2) / np.linalg.norm(high - low)
        return Solid(self.name, tuple(closed), tuple(sheets))


class SolidDistance:
    """Signed distance to a solid: negative inside. Inside overlapping parts it is a lower bound of the depth."""

    def __init__(self, solid: Solid) -> None:
        self._parts = [(_scene(mesh), mesh.bounds, True) for mesh in solid.closed]
        self._parts += [(_scene(mesh), mesh.bounds, False) for mesh in solid.sheets]

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        points = np.ascontiguousarray(points, np.float32)
        result = np.full(len(points), np.inf, np.float32)
        for scene, (low, high), closed in self._parts:
            beyond = np.maximum(np.maximum(low - points, points - high), 0.0)
            # a part whose box lies farther than the nearest surface so far cannot change the minimum
            near = np.flatnonzero(
                np.linalg.norm(beyond, axis=1) < np.maximum(result, 0) + SHEET_HALF_THICKNESS
            )
            if len(near) == 0:
                continue
            query = o3d.core.Tensor(points[near])
            distance = scene.compute_distance(query).numpy()
            if closed:
                boxed = np.flatnonzero((beyond[near] == 0).all(1))
                inside = (
                    scene.compute_occupancy(o3d.core.Tensor(points[near[boxed]]), nsamples=5).numpy() > 0.5
                )
                distance[boxed[inside]] *= -1
            else:
                distance = distance - SHEET_HALF_THICKNESS
            result[near] = np.minimum(result[near], distance)
        return result


def solidify(mesh: trimesh.Trimesh, name: str) -> Solid:
    """The solid that a mesh, closed or not, stands for.

    Raises:
        PriorError: it is empty or not finite, or its sign of distance is not sane; the message names it.
    """
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise PriorError(f"mesh {name} is empty or has vertices that are not finite: leave it out")
    components = mesh.split(only_watertight=False)
    closed = [part for part in components if part.is_watertight and abs(part.volume) > 1e-9]
    if len(closed) > _MAX_CLOSED_COMPONENTS:
        closed = []
    rest = [part for part in components if not any(part is c for c in closed)]
    sheets: list[trimesh.Trimesh] = []
    if rest:
        shell, loose = _close(rest, name)
        closed += shell
        sheets += loose
    solid = Solid(name, tuple(closed), tuple(sheets))
    check_sign(solid)
    return solid


def check_sign(solid: Solid, points: int = 1000, seed: int = 0) -> None:
    """Raise a PriorError unless the outside of the box is positive and the two sides of most surface differ."""
    distance = SolidDistance(solid)
    rng = np.random.default_rng(seed)
    corners = np.array(np.meshgrid(*[[-0.6, 0.6]] * 3)).reshape(3, -1).T
    if (distance(corners) <= 0).any():
        raise PriorError(
            f"mesh {solid.name} cannot be closed: points outside its box have a negative distance"
        )
    inside, outside = [], []
    for mesh in solid.closed:
        p, face = trimesh.sample.sample_surface(mesh, points, seed=rng)[:2]
        step = 1.5e-3 * mesh.face_normals[face]
        first, second = distance(p + step), distance(p - step)
        inside.append(np.minimum(first, second))
        outside.append(np.maximum(first, second))
    if not inside:
        return
    wrong = np.mean((np.concatenate(inside) > 2e-4) & (np.concatenate(outside) > 2e-4))
    if wrong > 0.2:
        raise PriorError(f"mesh {solid.name} cannot be closed: {wrong:.0%} of its surface has no inside")


def _close(parts: list[trimesh.Trimesh], name: str) -> tuple[list[trimesh.Trimesh], list[trimesh.Trimesh]]:
    """A watertight shell of open parts, and those faces of theirs that have no inside."""
    # a few flat sheets enclose nothing; a mesh that falls apart into many flat faces may
    if len(parts) <= _MAX_FLAT_COMPONENTS and all(_is_flat(part) for part in parts):
        return [], parts
    rest: trimesh.Trimesh = trimesh.util.concatenate(parts)  # pyright: ignore[reportAssignmentType]
    shell = _watertight(rest, name)
    scene = _scene(shell)
    points, face = trimesh.sample.sample_surface(rest, 15_000, seed=0)[:2]
    step = SHEET_HALF_THICKNESS * rest.face_normals[face]
    ahead, behind = (
        scene.compute_signed_distance(
            o3d.core.Tensor((points + s * step).astype(np.float32)), nsamples=3
        ).numpy()
        for s in (1, -1)
    )
    hollow = (ahead > 0) & (behind > 0)
    votes = np.bincount(face, minlength=len(rest.faces))
    lone = np.bincount(face, weights=hollow, minlength=len(rest.faces))
    thin = (votes > 0) & (lone > 0.5 * votes)
    sheets = [rest.submesh([np.flatnonzero(thin)], append=True)] if thin.any() else []
    return [shell], sheets  # pyright: ignore[reportReturnType]


def _is_flat(mesh: trimesh.Trimesh) -> bool:
    spread = np.linalg.svd(mesh.vertices - mesh.vertices.mean(0), compute_uv=False)
    return bool(spread[-1] < 1e-4)


def _watertight(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    """The closed surface around a mesh, made in a process of its own: on some sheets it never ends."""
    arguments = (
        np.asarray(mesh.vertices, np.float64),
        np.asarray(mesh.faces, np.int32),
        _WATERTIGHT_RESOLUTION,
    )
    with multiprocessing.get_context("fork").Pool(1) as pool:
        try:
            vertices, faces = pool.apply_async(_manifold, arguments).get(_WATERTIGHT_SECONDS)
        except multiprocessing.TimeoutError as error:
            raise PriorError(
                f"mesh {name} cannot be closed: no surface within {_WATERTIGHT_SECONDS} s"
            ) from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise PriorError(f"mesh {name} cannot be closed: no watertight surface came out")
    return trimesh.Trimesh(vertices, faces, process=False)


def _manifold(vertices: np.ndarray, faces: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    import point_cloud_utils as pcu

    return pcu.make_mesh_watertight(vertices, faces, resolution)


def _scene(mesh: trimesh.Trimesh) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    return scene
