"""A small software renderer: shaded meshes by ray casting, points by splatting; needs no display and no GPU."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from objgraph.errors import MapError
from objgraph.geometry.frames import transformed_back
from objgraph.observation.frames import Intrinsics

if TYPE_CHECKING:
    import open3d as o3d

_AMBIENT = 0.5
"""Share of a surface's colour that does not depend on where it faces."""
_CREASE = 0.8
"""Cosine between a triangle's and its vertices' normals below which the triangle is shaded flat."""


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from."""

    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]
    """OpenCV's axes: x right, y down, z forward."""


def finite_points(
    points_world: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"] | None
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"] | None]:
    """The points that are finite, metres, and their colours where there are any, RGB cut to 0..1.

    Raises:
        MapError: points and colours do not fit.
    """
    points = np.asarray(points_world, float).reshape(-1, 3)
    if colors is not None and np.shape(colors) != points.shape:
        raise MapError(f"{len(points)} points need as many RGB colours, not an array of {np.shape(colors)}")
    finite = np.isfinite(points).all(axis=1)
    return points[finite], None if colors is None else np.asarray(colors, float)[finite].clip(0, 1)


@dataclass(frozen=True)
class Surface:
    """A coloured mesh in the world frame."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    colors: Float[np.ndarray, "v 3"]
    """RGB in 0..1."""

    @cached_property
    def origin(self) -> Float[np.ndarray, "3"]:
        """Where `scene` begins, whole hundreds of metres in the world: rays are single precision's, which has steps of
        centimetres in maps of surveyed coordinates."""
        return np.round(self.vertices[:1].sum(axis=0), -2)

    @cached_property
    def scene(self) -> "o3d.t.geometry.RaycastingScene":
        """What rays are cast at, from `origin` on."""
        import open3d as o3d  # slow to import, and of no use before there is something to draw

        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles((self.vertices - self.origin).astype(np.float32), self.faces.astype(np.uint32))
        return scene

    @cached_property
    def normals(self) -> Float[np.ndarray, "v 3"]:
        """Of the vertices: their triangles', by area."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        areas = np.cross(b - a, c - a)
        normals = np.zeros_like(self.vertices)
        for i in range(3):
            np.add.at(normals, self.faces[:, i], areas)
        return _unit(normals)


@dataclass(frozen=True)
class Layer:
    """What one pass of the renderer drew."""

    color: Float[np.ndarray, "h w 3"]
    """RGB in 0..1; 0 where nothing was drawn."""
    depth: Float[np.ndarray, "h w"]
    """z-depth in metres; infinite where nothing was drawn."""


def project(camera: Camera, p_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Pixel coordinates and z-depth (u, v, z); what is behind the camera has z <= 0 and no meaning in u, v."""
    p_camera = transformed_back(camera.T_world_camera, p_world)
    safe = np.where(p_camera[:, 2:] > 1e-6, p_camera[:, 2:], 1.0)
    uv = camera.intrinsics.project(np.concatenate([p_camera[:, :2], safe], axis=1))
    return np.concatenate([uv, p_camera[:, 2:]], axis=1)


def draw_surfaces(camera: Camera, surfaces: Sequence[Surface]) -> Layer:
    """Meshes with smooth normals and Lambert shading by a lamp above the camera's left shoulder."""
    shape = (camera.intrinsics.height, camera.intrinsics.width)
    color, depth = np.zeros((*shape, 3)), np.full(shape, np.inf)
    if not surfaces:
        return Layer(color, depth)
    surface = joined(surfaces)
    directions = _directions(camera)
    eye = np.broadcast_to(camera.T_world_camera[:3, 3] - surface.origin, directions.shape)
    hits = surface.scene.cast_rays(np.concatenate([eye, directions], -1).astype(np.float32))
    hit = hits["t_hit"].numpy()  # directions have z = 1 in the camera frame, so this is z-depth
    seen = np.isfinite(hit)
    corners = surface.faces[hits["primitive_ids"].numpy()[seen]]
    uv = hits["primitive_uvs"].numpy()[seen].astype(float)
    weights = np.stack([1 - uv.sum(-1), uv[:, 0], uv[:, 1]], axis=-1)[..., None]
    flat = hits["primitive_normals"].numpy()[seen].astype(float)
    smooth = _unit((surface.normals[corners] * weights).sum(axis=1))
    creased = np.abs((flat * smooth).sum(axis=1)) < _CREASE
    normals = np.where(creased[:, None], flat, smooth)
    shade = _lambert(camera, normals, directions[seen])
    color[seen] = (surface.colors[corners] * weights).sum(axis=1) * shade[:, None]
    depth[seen] = hit[seen]
    return Layer(color.clip(0, 1), depth)


def draw_points(
    camera: Camera, p_world: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"], radius: float
) -> Layer:
    """Points as discs of `radius` metres (at least one pixel, at most 9 across); the nearest is seen."""
    height, width = camera.intrinsics.height, camera.intrinsics.width
    owner, depth = np.full(height * width, -1), np.full(height * width, np.inf)
    uvz = project(camera, p_world)
    kept = uvz[:, 2] > 0.05
    uvz, colors = uvz[kept], colors[kept]
    order = np.argsort(-uvz[:, 2])  # far ones first, so that near ones are written over them
    (u, v, z), colors = uvz[order].T, colors[order]
    pixels = np.clip(radius * camera.intrinsics.fx / z, 0.5, 4.5)
    for du, dv in _disc(4):
        first = int(np.searchsorted(pixels, np.hypot(du, dv)))  # near ones are large
        at_u, at_v = np.round(u[first:] + du).astype(int), np.round(v[first:] + dv).astype(int)
        inside = np.flatnonzero((at_u >= 0) & (at_u < width) & (at_v >= 0) & (at_v < height))
        index, which = at_v[inside] * width + at_u[inside], inside + first
        closer = z[which] < depth[index]
        index, which = index[closer], which[closer]
        depth[index], owner[index] = z[which], which  # of several at one pixel the last stays, the nearest
    color = np.where(owner[:, None] >= 0, colors[owner], 0.0) if len(colors) else np.zeros((len(owner), 3))
    return Layer(color.reshape(height, width, 3), depth.reshape(height, width))


def compose(
    points: Layer, surfaces: Layer, background: Float[np.ndarray, "3"], bias: float
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The picture and where a surface shows: it wins over points up to `bias` metres in front of it."""
    picture = np.where(np.isfinite(points.depth)[..., None], points.color, background)
    shows = np.isfinite(surfaces.depth) & (surfaces.depth < points.depth + bias)
    return np.where(shows[..., None], surfaces.color, picture), shows


def joined(surfaces: Sequence[Surface]) -> Surface:
    """All in one, which draws several pictures faster."""
    if len(surfaces) == 1:
        return surfaces[0]
    starts = np.cumsum([0] + [len(s.vertices) for s in surfaces[:-1]])
    return Surface(
        np.concatenate([s.vertices for s in surfaces]),
        np.concatenate([s.faces + start for s, start in zip(surfaces, starts, strict=True)]),
        np.concatenate([s.colors for s in surfaces]),
    )


def _directions(camera: Camera) -> Float[np.ndarray, "h w 3"]:
    v, u = np.mgrid[: camera.intrinsics.height, : camera.intrinsics.width]
    return camera.intrinsics.backproject(u, v) @ camera.T_world_camera[:3, :3].T


def _unit(rows: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True).clip(min=1e-12)


def _lambert(
    camera: Camera, normals: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    lamp = camera.T_world_camera[:3, :3] @ np.array([-0.35, -0.75, -0.9])
    lamp /= np.linalg.norm(lamp)
    facing = np.where((normals * directions).sum(axis=1) > 0, -1.0, 1.0)
    return _AMBIENT + (1 - _AMBIENT) * np.clip(facing * (normals @ lamp), 0, 1)


def _disc(radius: int) -> list[tuple[int, int]]:
    span = range(-radius, radius + 1)
    return [(du, dv) for du in span for dv in span if np.hypot(du, dv) <= radius + 0.5]
