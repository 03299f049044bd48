"""Pictures of a map, drawn without a display: meshes over the scan's points, coloured by how sure they are."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import matplotlib
import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from objgraph.errors import MapError
from objgraph.maps.colors import sigma_colors, sigma_limit
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Intrinsics
from objgraph.show import figure, raster
from objgraph.show import framing as views
from objgraph.show.summary import heading_zero

_BACKGROUND = np.ones(3)
_OVERSAMPLING = 2
_AROUND = 0.8
"""How far from the objects, in metres, the scan's points are still drawn."""
_ABOVE = 0.15
"""How far above the highest object; higher points would hide the room."""
_BIAS = 0.12
"""A surface counts as seen behind points this close in front of it, metres: both stand for the same thing."""
_FLOOR = 0.06
"""Up to this far above the objects' lowest point is floor, metres."""
_ELEVATION = np.radians(38)
"""Of the oblique view."""
_PLAIN = matplotlib.colormaps["tab10"]
"""Colours of objects without sigma."""


class _Cloud(NamedTuple):
    points: Float[np.ndarray, "n 3"]
    colors: Float[np.ndarray, "n 3"]
    radius: float = 0.008


def map_picture(
    object_map: ObjectMap,
    points_world: Float[np.ndarray, "n 3"],
    colors: Float[np.ndarray, "n 3"] | None,
    path: Path | str,
    *,
    width: int = 1600,
    point_radius: float = 0.008,
) -> None:
    """Write a PNG of the map from obliquely above and from straight above, over the scan's points.

    Surfaces are coloured by their standard deviation on one scale for all objects, or by object where none
    is given. `colors` are RGB in 0..1. The oblique view is taken from where most of the objects is seen,
    without the walls in between; points never hide a surface.

    Raises:
        MapError: no object has a mesh, or points and colours do not fit.
    """
    shown = [entry for entry in object_map.objects if entry.vertices is not None]
    if not shown:
        raise MapError(f"map of {object_map.scene}: no object has a mesh, so there is nothing to draw")
    up = object_map.up_world
    corners = np.concatenate([_vertices(entry) for entry in shown])
    cloud = _around(_cloud(points_world, colors, up), corners, up, point_radius)
    limit = sigma_limit(entry.vertex_sigma for entry in shown)
    surface = raster.joined([_surface(entry, i, limit) for i, entry in enumerate(shown)])
    size = (width * 45 // 100, width * 36 // 100)
    direction = _clearest_direction(corners, cloud, surface, up, size)
    oblique = views.framing_camera(corners, direction, up, _intrinsics(size), fill=0.9)
    across = views.level_axis_across(corners, up)
    above = views.framing_camera(corners, up, across, _intrinsics(size), fill=0.85)
    title = f"{object_map.scene}: {len(object_map.mapped)} of {len(object_map.objects)} objects mapped"
    sheet, axes, bar = figure.panels(width, size, 2, title, limit)
    figure.show(axes[0], _render(oblique, _cut_away(cloud, corners, direction, up), surface), "oblique")
    figure.show(axes[1], _render(above, cloud, surface), "from above")
    names = [_name(entry) for entry in shown]
    for axis, camera in zip(axes, (oblique, above), strict=True):
        figure.label(axis, names, _label_places(camera, shown, up))
    figure.finish(sheet, bar, limit, Path(path))


def _name(entry: MappedObject) -> str:
    return f"{entry.name}{' (fallback)' if entry.is_fallback else ''}"


def _vertices(entry: MappedObject) -> Float[np.ndarray, "v 3"]:
    return np.empty((0, 3)) if entry.vertices is None else entry.vertices


def _cloud(
    points: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"] | None, up: Float[np.ndarray, "3"]
) -> _Cloud:
    """The finite points and their colours; without colours, greys by height."""
    points, colors = raster.finite_points(points, colors)
    if colors is not None:
        return _Cloud(points, colors)
    height = points @ up
    share = (height - height.min()) / max(np.ptp(height), 1e-6) if len(points) else height
    return _Cloud(points, np.repeat(0.85 - 0.45 * share[:, None], 3, axis=1))


def _around(
    cloud: _Cloud, corners: Float[np.ndarray, "v 3"], up: Float[np.ndarray, "3"], radius: float
) -> _Cloud:
    """The part of the cloud near the objects, thinned, and a little faded so that the meshes stand out."""
    import open3d as o3d  # slow to import

    points = cloud.points
    near = ((points > corners.min(axis=0) - _AROUND) & (points < corners.max(axis=0) + _AROUND)).all(axis=1)
    near &= points @ up < (corners @ up).max() + _ABOVE
    thick = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[near]))
    thick.colors = o3d.utility.Vector3dVector(0.55 * cloud.colors[near] + 0.45 * 0.92)
    thin = thick.voxel_down_sample(radius)
    return _Cloud(np.asarray(thin.points), np.asarray(thin.colors), radius)


def _cut_away(
    cloud: _Cloud,
    corners: Float[np.ndarray, "v 3"],
    direction: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
) -> _Cloud:
    """The cloud without the walls between the camera and the objects, as in a doll's house.

    Left out is what stands above the floor beyond those sides of the objects' common footprint that face the
    camera.
    """
    level = np.stack([heading_zero(up), np.cross(up, heading_zero(up))])
    try:
        sides = ConvexHull(corners @ level.T).equations
    except QhullError:  # the footprint is a line or a point
        return cloud
    facing = sides[sides[:, :2] @ (level @ direction) > 0]
    beyond = (cloud.points @ level.T @ facing[:, :2].T + facing[:, 2] > 0.02).any(axis=1)
    kept = ~beyond | (cloud.points @ up < (corners @ up).min() + _FLOOR)
    return _Cloud(cloud.points[kept], cloud.colors[kept], cloud.radius)


def _surface(entry: MappedObject, index: int, limit: float | None) -> raster.Surface:
    vertices, faces = _vertices(entry), entry.faces
    if entry.vertex_sigma is not None and limit is not None:
        colors = sigma_colors(entry.vertex_sigma, limit) / 255
    else:
        colors = np.tile(np.array(_PLAIN(index % 10))[:3], (len(vertices), 1))
    return raster.Surface(vertices, np.empty((0, 3), int) if faces is None else faces, colors)


def _intrinsics(size: tuple[int, int]) -> Intrinsics:
    return views.intrinsics_for(size[0] * _OVERSAMPLING, size[1] * _OVERSAMPLING)


def _clearest_direction(
    corners: Float[np.ndarray, "v 3"],
    cloud: _Cloud,
    surface: raster.Surface,
    up: Float[np.ndarray, "3"],
    size: tuple[int, int],
) -> Float[np.ndarray, "3"]:
    """Towards that one of 12 cameras around the scene which sees the largest area of the objects."""
    step = max(1, len(cloud.points) // 20_000)
    sample = _Cloud(cloud.points[::step], cloud.colors[::step], 0.03)
    small = views.intrinsics_for(size[0] // 6, size[1] // 6)

    def seen(direction: Float[np.ndarray, "3"]) -> int:
        camera = views.framing_camera(corners, direction, up, small)
        opened = _cut_away(sample, corners, direction, up)
        points = raster.draw_points(camera, opened.points, opened.colors, opened.radius)
        meshes = raster.draw_surfaces(camera, [surface])
        return int(raster.compose(points, meshes, _BACKGROUND, _BIAS)[1].sum())

    azimuths = np.arange(12) * np.pi / 6 + np.pi / 12
    return max((views.oblique_direction(up, azimuth, _ELEVATION) for azimuth in azimuths), key=seen)


def _render(camera: raster.Camera, cloud: _Cloud, surface: raster.Surface) -> Float[np.ndarray, "h w 3"]:
    points = raster.draw_points(camera, cloud.points, cloud.colors, cloud.radius)
    meshes = raster.draw_surfaces(camera, [surface])
    picture, _ = raster.compose(points, meshes, _BACKGROUND, bias=np.inf)  # no point hides an estimate
    share = 1 / _OVERSAMPLING
    return cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA).clip(0, 1)


def _label_places(
    camera: raster.Camera, shown: Sequence[MappedObject], up: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    """Pixels of the middle of each object's upper end."""
    tops = []
    for entry in shown:
        vertices = _vertices(entry)
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        tops.append(middle + ((vertices @ up).max() - middle @ up) * up)
    return raster.project(camera, np.array(tops))[:, :2] / _OVERSAMPLING
