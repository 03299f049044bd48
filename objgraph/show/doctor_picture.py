"""One frame as it was understood: the objects' outlines, the floor and which way is up."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.colors import to_rgb

from objgraph.geometry.frames import level_axes, transformed, transformed_back
from objgraph.maps.colors import COLORS
from objgraph.observation.frames import Frame, Instance
from objgraph.show import figure, raster
from objgraph.show.report.views import image_of, known_depth

_WIDTH = 960
"""Of the picture, in pixels."""
_FLOOR_M = 0.05
"""Height above and below the floor that is tinted."""
_GRID_M, _REACH_M = 0.25, 6.0
"""Spacing of the dots on the floor, and how far from the camera there are any."""
_HIDDEN = 0.05
"""Metres, or this share of the depth where that is more, that a dot must be behind what is seen to be hidden."""
_TINT, _UP = to_rgb(COLORS[5]), to_rgb(COLORS[1])
_OUTLINES = tuple(color for color in COLORS if color not in (COLORS[1], COLORS[5]))


def doctor_picture(
    frame: Frame,
    instances: Sequence[Instance],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    path: Path,
) -> None:
    """Write a PNG of a frame; `floor` is the floor's height along `up_world` in metres, None where none is known."""
    frame = replace(frame, depth=known_depth(frame))
    scale = _WIDTH / frame.intrinsics.width
    size = (_WIDTH, round(scale * frame.intrinsics.height))
    image = cv2.resize(image_of(frame), size, interpolation=cv2.INTER_LINEAR)
    if floor is not None:
        image = _tinted(image, np.abs(_heights(frame, up_world) - floor) < _FLOOR_M)
        for u, v in _dots(frame, up_world, floor) * scale:
            cv2.circle(image, (round(u), round(v)), 3, (255, 255, 255), -1, cv2.LINE_AA)
            cv2.circle(image, (round(u), round(v)), 3, (40, 40, 40), 1, cv2.LINE_AA)
    labels = _outline(image, frame, instances, scale)
    labels["up"] = _arrow(image, frame, up_world, scale)
    floor_text = (
        "no floor is known"
        if floor is None
        else f"tinted: within {100 * _FLOOR_M:.0f} cm of the floor; dots: the floor, every {100 * _GRID_M:.0f} cm"
    )
    sheet, (axis,), _ = figure.panels(
        _WIDTH * 100 // 91, size, 1, f"frame {frame.name.removeprefix('frame-')}", None
    )
    figure.show(axis, image / 255.0, f"outlines: masks; {floor_text}; arrow: up")
    figure.label(axis, list(labels), np.array(list(labels.values())))
    figure.finish(sheet, None, None, path)


def _heights(frame: Frame, up_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w"]:
    """Along up, of what every pixel shows; infinite where there is no depth."""
    v, u = np.mgrid[: frame.depth.shape[0], : frame.depth.shape[1]]
    p_camera = frame.intrinsics.backproject(u.ravel(), v.ravel()) * frame.depth.ravel()[:, None]
    heights = transformed(frame.T_world_camera, p_camera) @ up_world
    return np.where(frame.depth > 0, heights.reshape(frame.depth.shape), np.inf)


def _tinted(image: UInt8[np.ndarray, "h w 3"], near: Bool[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    share = (
        0.45
        * cv2.resize(near.astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_LINEAR)[..., None]
    )
    return ((1 - share) * image + share * 255 * np.array(_TINT)).astype(np.uint8)


def _dots(frame: Frame, up_world: Float[np.ndarray, "3"], floor: float) -> Float[np.ndarray, "n 2"]:
    """Pixels of a grid on the floor, where there is depth and nothing nearer hides them."""
    level = np.stack(level_axes(up_world))
    count = int(_REACH_M / _GRID_M)
    around = np.stack(np.meshgrid(*2 * [np.arange(-count, count + 1)]), axis=-1).reshape(-1, 2)
    middle = np.round(level @ frame.T_world_camera[:3, 3] / _GRID_M)
    p_world = (middle + around) * _GRID_M @ level + floor * up_world
    camera = raster.Camera(frame.intrinsics, frame.T_world_camera)
    uvz = raster.project(camera, p_world)
    u, v = np.round(uvz[:, :2]).T
    inside = (
        (uvz[:, 2] > _HIDDEN)
        & (u >= 0)
        & (u < frame.intrinsics.width)
        & (v >= 0)
        & (v < frame.intrinsics.height)
    )
    uvz = uvz[inside]
    seen = frame.depth[v[inside].astype(int), u[inside].astype(int)]
    shown = (seen > 0) & (uvz[:, 2] <= seen + _HIDDEN * np.maximum(1.0, seen))
    return uvz[shown, :2]


def _outline(
    image: UInt8[np.ndarray, "h w 3"], frame: Frame, instances: Sequence[Instance], scale: float
) -> dict[str, Float[np.ndarray, "2"]]:
    """Draw each mask's outline; by the object's name the pixel deepest inside of its mask."""
    places = {}
    for i, instance in enumerate(instances):
        mask = (frame.instances == instance.id).astype(np.uint8)
        if not mask.any():
            continue
        inside = cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        v, u = np.unravel_index(np.argmax(inside), inside.shape)
        places[f"{instance.category} {instance.id}"] = np.array([u, v]) * scale
        large = cv2.resize(mask.astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_LINEAR) > 0.5
        contours, _ = cv2.findContours(large.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        for color, thickness in (((255, 255, 255), 4), (_bytes(to_rgb(_OUTLINES[i % len(_OUTLINES)])), 2)):
            cv2.drawContours(image, contours, -1, color, thickness, cv2.LINE_AA)
    return places


def _arrow(
    image: UInt8[np.ndarray, "h w 3"], frame: Frame, up_world: Float[np.ndarray, "3"], scale: float
) -> Float[np.ndarray, "2"]:
    """Draw up at the left of the picture, in perspective at the median depth; the pixel where it begins."""
    K = frame.intrinsics
    known = frame.depth[frame.depth > 0]
    depth = float(np.median(known)) if len(known) else 1.0
    foot = K.backproject(np.array([0.1 * K.width]), np.array([0.6 * K.height])) * depth
    tip = foot + 0.25 * depth * K.height / K.fy * transformed_back(
        frame.T_world_camera, frame.T_world_camera[:3, 3] + up_world[None]
    )
    begin, end = (K.project(p)[0] * scale for p in (foot, tip))
    for color, thickness in (((255, 255, 255), 8), (_bytes(_UP), 4)):
        cv2.arrowedLine(
            image,
            tuple(np.round(begin).astype(int).tolist()),
            tuple(np.round(end).astype(int).tolist()),
            color,
            thickness,
            cv2.LINE_AA,
            tipLength=0.2,
        )
    return begin + [0, 22]


def _bytes(rgb: Sequence[float]) -> tuple[int, int, int]:
    r, g, b = (round(255 * value) for value in rgb)
    return r, g, b
