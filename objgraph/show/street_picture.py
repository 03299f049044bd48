"""A mapped scan as a picture: from above with boxes and ellipses of uncertainty, and the outlines in the camera's image."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull
from scipy.stats import chi2

from objgraph.errors import MapError
from objgraph.geometry.boxes import OrientedBox
from objgraph.maps.colors import COLORS
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.lidar.frame import LidarFrame, Picture
from objgraph.show import summary
from objgraph.show.figure import finish
from objgraph.show.placement import LEVEL, box_of, place_of
from objgraph.show.raster import Camera, Surface, draw_surfaces

_MAGNIFIED = 5.0
"""Times that an ellipse is drawn larger than it is: they measure centimetres."""
_AROUND = 5.0
"""Metres about the objects that are shown from above."""
_FOOTPRINT = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2


def street_picture(object_map: ObjectMap, frame: LidarFrame, path: Path) -> None:
    """Write a PNG of a mapped scan.

    Raises:
        MapError: a mapped object has no mesh.
    """
    low, high = _reach(frame)
    heights = [float(np.clip((high - low)[1] / (high - low)[0], 0.25, 0.8))]
    if frame.picture is not None:
        heights.append(frame.picture.intrinsics.height / frame.picture.intrinsics.width)
    figure = Figure(figsize=(12, 1.2 + 11 * sum(heights)), dpi=100, layout="compressed")
    axes = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    _from_above(axes[0], object_map, frame)
    axes[0].set_xlim(low[0], high[0])
    axes[0].set_ylim(low[1], high[1])
    if frame.picture is not None:
        axes[1].imshow(outlined(object_map, frame.picture))
        axes[1].set_axis_off()
    count = f"{len(object_map.mapped)} of {len(object_map.objects)} objects mapped"
    figure.suptitle(f"{object_map.scene}: {count}", fontsize=13, weight="bold")
    finish(figure, None, None, path)


def outlined(object_map: ObjectMap, picture: Picture) -> UInt8[np.ndarray, "h w 3"]:
    """The camera's image with the silhouette of every mesh."""
    image = picture.color.copy()
    camera = Camera(picture.intrinsics, picture.T_world_camera)
    for i, entry in enumerate(object_map.mapped):
        shown = np.isfinite(draw_surfaces(camera, [_surface(entry)]).depth).astype(np.uint8)
        contours, _ = cv2.findContours(shown, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, contours, -1, _rgb(i), 2, cv2.LINE_AA)
    return image


def _from_above(axis: Axes, object_map: ObjectMap, frame: LidarFrame) -> None:
    """Ahead is to the right, so that a street fits the page."""
    plan = _Plan.of(frame)
    axis.plot(*plan.at(frame.p_world).T, ",", color="0.6", zorder=0)
    for each in frame.detections:
        axis.add_patch(_outline(each.box, plan, edgecolor="0.35", linestyle="--", zorder=2))
    for i, entry in enumerate(object_map.mapped):
        _object_from_above(axis, entry, plan, COLORS[i % len(COLORS)])
    axis.set_aspect("equal")
    axis.set_xlabel("ahead of the LiDAR (m)")
    axis.set_ylabel("to its left (m)")
    calibrated = all(entry.box_covariance is not None for entry in object_map.mapped)
    raw = "" if calibrated else " (not calibrated: too small)"
    handles = [
        Line2D([], [], color="0.35", linestyle="--", label="detection"),
        Line2D([], [], color=COLORS[0], label="estimate: box, footprint"),
        Line2D(
            [],
            [],
            color=COLORS[0],
            lw=2.5,
            label=f"95 % ellipse of its middle, {_MAGNIFIED:.0f} times as large{raw}",
        ),
    ]
    axis.legend(handles=handles, loc="upper left", fontsize=8)


class _Plan(NamedTuple):
    """What is seen from above, metres ahead of the LiDAR and to its left."""

    origin: Float[np.ndarray, "3"]
    """The LiDAR's place in the world."""
    level: Float[np.ndarray, "3 2"]
    """Ahead and left in the world."""

    @staticmethod
    def of(frame: LidarFrame) -> "_Plan":
        T = frame.T_world_lidar
        return _Plan(T[:3, 3], np.stack([T[:3, 2], -T[:3, 0]], axis=1))

    def at(self, p_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        return (p_world - self.origin) @ self.level


def _reach(frame: LidarFrame) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower and upper corner of what is shown from above."""
    if not frame.detections:
        return np.array([0.0, -15.0]), np.array([40.0, 15.0])
    places = _Plan.of(frame).at(np.stack([each.T_world_object[:3, 3] for each in frame.detections]))
    return places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND


def _object_from_above(axis: Axes, entry: MappedObject, plan: _Plan, color: str) -> None:
    footprint = plan.at(_surface(entry).vertices)
    hull = footprint[ConvexHull(footprint).vertices]
    axis.add_patch(Polygon(hull, facecolor=color, alpha=0.25, zorder=1))
    if (box := box_of(entry)) is not None:
        axis.add_patch(_outline(box, plan, edgecolor=color, zorder=3))
    place = place_of(entry)
    assert place is not None  # it is mapped
    u, v = plan.at(place.centre)
    if place.covariance is not None:
        known = summary.position_covariance(place.T_world_object, place.covariance)
        values, vectors = np.linalg.eigh(plan.level.T @ known @ plan.level)
        turn = np.linspace(0, 2 * np.pi, 60)
        radii = _MAGNIFIED * np.sqrt(chi2.ppf(LEVEL, 2) * values.clip(min=0.0))
        ellipse = (np.column_stack([np.cos(turn), np.sin(turn)]) * radii) @ vectors.T
        axis.plot(*(ellipse + (u, v)).T, color=color, lw=2.5, zorder=5)
    axis.annotate(
        entry.name,
        (u, v),
        xytext=(0, 16),
        textcoords="offset points",
        fontsize=8,
    )


def _surface(entry: MappedObject) -> Surface:
    if entry.vertices is None or entry.faces is None:
        raise MapError(f"{entry.name} has no mesh to draw")
    return Surface(entry.vertices, entry.faces, np.ones((len(entry.vertices), 3)))


def _outline(box: OrientedBox, plan: _Plan, **style) -> Polygon:
    across = np.zeros((4, 3))
    across[:, [0, 2]] = _FOOTPRINT * box.extents[[0, 2]]
    corners = box.centre + across @ box.rotation.T
    return Polygon(plan.at(corners), fill=False, **style)


def _rgb(i: int) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in to_rgb(COLORS[i % len(COLORS)]))
