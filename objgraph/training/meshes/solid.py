"""Meshes of any quality as solids with a robust signed distance.

Collected CAD meshes overlap, have open shells and single sheets. Closed components are united (the least of
their signed distances); the rest is closed by `point_cloud_utils` (Huang et al., "Robust Watertight Manifold
Surface Generation Method for ShapeNet Models", 2018); what stays a sheet becomes a thin solid.
"""

import importlib.util
import multiprocessing
import signal
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Bool, Float

from objgraph.errors import PriorError
from objgraph.geometry.meshes import signed_volume
from objgraph.training.meshes.files import MeshError, MeshTimeoutError

SHEET_HALF_THICKNESS = 0.003
"""Half the thickness given to single sheets, in canonical units: some 3 mm on a chair."""

SOLID_VERSION = 5
"""Part of the cache's keys: raised whenever `solidify` or `joined` gives other distances for the same mesh."""

_MAX_CLOSED_COMPONENTS = 60
_MAX_FLAT_COMPONENTS = 6
_WATERTIGHT_RESOLUTION = 10_000
_WATERTIGHT_SECONDS = 240


@dataclass(frozen=True)
class Shell:
    """A mesh with holes and the watertight surface around it, which stands off by about a voxel."""

    watertight: trimesh.Trimesh
    original: trimesh.Trimesh


@dataclass(frozen=True)
class Solid:
    """A union of closed meshes, of meshes closed by shells, and of sheets, in one frame."""

    name: str
    closed: tuple[trimesh.Trimesh, ...]
    shells: tuple[Shell, ...] = ()
    sheets: tuple[trimesh.Trimesh, ...] = ()

    @property
    def surfaces(self) -> tuple[trimesh.Trimesh, ...]:
        """The meshes whose faces the solid's surface is made of."""
        return (*self.closed, *(shell.original for shell in self.shells), *self.sheets)

    @property
    def extents(self) -> Float[np.ndarray, "3"]:
        """Edges of its bounding box."""
        bounds = np.array([mesh.bounds for mesh in self.surfaces])
        return bounds[:, 1].max(0) - bounds[:, 0].min(0)

    def warped(self, warp: Callable[[Float[np.ndarray, "v 3"]], Float[np.ndarray, "v 3"]]) -> "Solid":
        """The solid with its vertices moved, then centred and brought back to a box diagonal of 1."""
        bounds = np.array([_box_of(warp(np.asarray(mesh.vertices))) for mesh in self.surfaces])
        low, high = bounds[:, 0].min(0), bounds[:, 1].max(0)

        def moved(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
            vertices = (warp(np.asarray(mesh.vertices)) - (low + high) / 2) / np.linalg.norm(high - low)
            return trimesh.Trimesh(vertices, mesh.faces, process=False)

        return Solid(
            self.name,
            tuple(moved(mesh) for mesh in self.closed),
            tuple(Shell(moved(shell.watertight), moved(shell.original)) for shell in self.shells),
            tuple(moved(mesh) for mesh in self.sheets),
        )


class SolidDistance:
    """Signed distance to a solid: negative inside. Inside overlapping parts it is a lower bound of the depth."""

    def __init__(self, solid: Solid) -> None:
        self._parts = [(mesh.bounds, _ClosedDistance(mesh)) for mesh in solid.closed]
        self._parts += [(shell.watertight.bounds, _ShellDistance(shell)) for shell in solid.shells]
        self._parts += [(mesh.bounds, _SheetDistance(mesh)) for mesh in solid.sheets]

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        points = np.ascontiguousarray(points, np.float32)
        result = np.full(len(points), np.inf, np.float32)
        for (low, high), distance in self._parts:
            beyond = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
            # a part whose box lies farther than the nearest surface so far cannot change the minimum
            near = np.flatnonzero(beyond < np.maximum(result, 0) + SHEET_HALF_THICKNESS)
            if len(near):
                result[near] = np.minimum(result[near], distance(points[near], beyond[near] == 0))
        return result


class _ClosedDistance:
    """Signed distance to one closed mesh; `boxed` says which points lie in its bounding box."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._scene = _scene(mesh)

    def __call__(
        self, points: Float[np.ndarray, "n 3"], boxed: Bool[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        distance = self._scene.compute_distance(o3d.core.Tensor(points)).numpy().copy()
        candidates = np.flatnonzero(boxed)
        if len(candidates):
            inside = (
                self._scene.compute_occupancy(o3d.core.Tensor(points[candidates]), nsamples=5).numpy() > 0.5
            )
            distance[candidates[inside]] *= -1
        return distance


class _ShellDistance:
    """Distance to the original faces, with the sign of the shell set back by its stand-off."""

    def __init__(self, shell: Shell) -> None:
        self._shell = _ClosedDistance(shell.watertight)
        self._original = _scene(shell.original)
        points = np.asarray(trimesh.sample.sample_surface(shell.original, 3000, seed=0)[0], np.float32)
        self._stand_off = float(np.median(-self._shell(points, np.ones(len(points), bool))))

    def __call__(
        self, points: Float[np.ndarray, "n 3"], boxed: Bool[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        set_back = self._shell(points, boxed) + self._stand_off
        distance = self._original.compute_distance(o3d.core.Tensor(points)).numpy()
        # faces within the solid are no surface: there the deeper of the two counts
        return np.where(set_back > 0, distance, np.minimum(-distance, set_back))


class _SheetDistance:
    """Distance to faces that enclose nothing, thickened."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._scene = _scene(mesh)

    def __call__(
        self, points: Float[np.ndarray, "n 3"], boxed: Bool[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        del boxed
        return self._scene.compute_distance(o3d.core.Tensor(points)).numpy() - SHEET_HALF_THICKNESS


def require_libraries() -> None:
    """Look for what closes and cuts meshes, before work on them begins.

    Raises:
        PriorError: it is not installed.
    """
    missing = [name for name in ("manifold3d", "point_cloud_utils") if importlib.util.find_spec(name) is None]
    if missing:
        raise PriorError(f"meshes need {' and '.join(missing)}: pip install 'objgraph[train]'")


def require_depth(extents: Float[np.ndarray, "3"], name: str) -> None:
    """Raise a MeshError where a box of diagonal 1 is flat: what is in it is thicker, once it is a sheet, and cannot be stretched
    to a box."""
    if not extents.min() >= 2 * SHEET_HALF_THICKNESS:
        raise MeshError(f"{name} is flat: no box can be filled by it")


def solidify(mesh: trimesh.Trimesh, name: str) -> Solid:
    """The solid that a mesh, closed or not, stands for; holes of three or four edges are filled first.

    Raises:
        MeshError: it is empty, not finite or without area, or its sign of distance is not sane; the message names it.
    """
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise MeshError(f"mesh {name} is empty or has vertices that are not finite: leave it out")
    if not mesh.area > 0:
        raise MeshError(f"mesh {name} has no area: leave it out")
    components = mesh.split(only_watertight=False, repair=True)
    closed = [part for part in components if part.is_watertight and abs(signed_volume(part)) > 1e-9]
    if len(closed) > _MAX_CLOSED_COMPONENTS:
        closed = []
    rest = [part for part in components if not any(part is c for c in closed)]
    shells, sheets = _close(rest, name) if rest else ((), ())
    solid = Solid(name, tuple(closed), shells, sheets)
    check_sign(solid)
    return solid


def check_sign(solid: Solid, points: int = 1000, seed: int = 0) -> None:
    """Raise a MeshError unless the outside of the box is positive and the two sides of most surface differ."""
    distance = SolidDistance(solid)
    rng = np.random.default_rng(seed)
    corners = np.array(np.meshgrid(*[[-0.6, 0.6]] * 3)).reshape(3, -1).T
    if (distance(corners) <= 0).any():
        raise MeshError(
            f"mesh {solid.name} cannot be closed: points outside its box have a negative distance"
        )
    inside, outside = [], []
    for mesh in (*solid.closed, *(shell.original for shell in solid.shells)):
        p, face = trimesh.sample.sample_surface(mesh, points, seed=rng)[:2]
        step = 1.5e-3 * mesh.face_normals[face]
        first, second = distance(p + step), distance(p - step)
        inside.append(np.minimum(first, second))
        outside.append(np.maximum(first, second))
    if not inside:
        return
    wrong = np.mean((np.concatenate(inside) > 2e-4) & (np.concatenate(outside) > 2e-4))
    if wrong > 0.2:
        raise MeshError(f"mesh {solid.name} cannot be closed: {wrong:.0%} of its surface has no inside")


def _close(parts: list[trimesh.Trimesh], name: str) -> tuple[tuple[Shell, ...], tuple[trimesh.Trimesh, ...]]:
    """A shell around open parts, and those faces of theirs that have no inside."""
    # a few flat sheets enclose nothing; a mesh that falls apart into many flat faces may
    if len(parts) <= _MAX_FLAT_COMPONENTS and all(_is_flat(part) for part in parts):
        return (), tuple(parts)
    rest: trimesh.Trimesh = trimesh.util.concatenate(parts)  # pyright: ignore[reportAssignmentType]
    shell = Shell(_watertight(rest, name), rest)
    distance = _ShellDistance(shell)
    points, face = trimesh.sample.sample_surface(rest, 15_000, seed=0)[:2]
    step = SHEET_HALF_THICKNESS * rest.face_normals[face]
    everywhere = np.ones(len(points), bool)
    ahead, behind = (distance((points + s * step).astype(np.float32), everywhere) for s in (1, -1))
    hollow = (ahead > 0) & (behind > 0)
    votes = np.bincount(face, minlength=len(rest.faces))
    lone = np.bincount(face, weights=hollow, minlength=len(rest.faces))
    thin = (votes > 0) & (lone > 0.5 * votes)
    if thin.all() or hollow.mean() > 0.98:
        return (), (rest,)
    sheet = (rest.submesh([np.flatnonzero(thin)], append=True),) if thin.any() else ()
    return (shell,), sheet  # pyright: ignore[reportReturnType]


def _box_of(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "2 3"]:
    return np.stack([vertices.min(0), vertices.max(0)])


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
    # it ends by itself, too, should this process be killed
    with multiprocessing.get_context("fork").Pool(1, signal.alarm, (2 * _WATERTIGHT_SECONDS,)) as pool:
        try:
            vertices, faces = pool.apply_async(_manifold, arguments).get(_WATERTIGHT_SECONDS)
        except multiprocessing.TimeoutError as error:
            raise MeshTimeoutError(
                f"mesh {name} cannot be closed: no surface within {_WATERTIGHT_SECONDS} s"
            ) from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise MeshError(f"mesh {name} cannot be closed: no watertight surface came out")
    return trimesh.Trimesh(vertices, faces, process=False)


def _manifold(vertices: np.ndarray, faces: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    import point_cloud_utils as pcu

    return pcu.make_mesh_watertight(vertices, faces, resolution)


def _scene(mesh: trimesh.Trimesh) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    return scene
