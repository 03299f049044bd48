"""The frames that an object was mapped from, cut out about it, with the outline of its estimate."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from objgraph.maps.mapped_object import MappedObject
from objgraph.observation.frames import Frame, FrameSource, Intrinsics
from objgraph.show import raster

_MARGIN = 0.15
"""About the outline and the mask, of their larger edge."""
_WIDTH = 360
"""Of a picture, in pixels."""
_OUTLINE, _MASK = (213, 94, 0), (0, 114, 178)
"""Of the estimate and of the mask (Okabe and Ito's vermilion and blue), RGB."""


@dataclass(frozen=True)
class ObjectPicture:
    """A view of one object."""

    frame: str
    rgb: UInt8[np.ndarray, "h w 3"]


def object_pictures(entries: Sequence[MappedObject], frames: FrameSource) -> dict[int, list[ObjectPicture]]:
    """By object, one picture a view that it was mapped from, of those that the scan still has."""
    index: dict[str, list[int]] = {}
    for i, name in enumerate(frames.names):
        index.setdefault(name, []).append(i)
    found = {}
    for entry in entries:
        if entry.vertices is None or entry.faces is None or entry.cameras is None:
            continue
        surface = raster.Surface(entry.vertices, entry.faces, np.ones_like(entry.vertices))
        found[entry.id] = [
            _picture(_taken_from(T_world_camera, frames, index[name]), T_world_camera, entry.id, surface)
            for name, T_world_camera in zip(entry.views, entry.cameras, strict=True)
            if name in index
        ]
    return found


def _taken_from(T_world_camera: Float[np.ndarray, "4 4"], frames: FrameSource, alike: Sequence[int]) -> Frame:
    """Of frames of one name, as several cameras may have them, the one of this pose."""

    def away(frame: Frame) -> float:
        return float(np.nan_to_num(np.abs(frame.T_world_camera - T_world_camera), nan=np.inf).max())

    return min((frames[i] for i in alike), key=away)


def _picture(
    frame: Frame, T_world_camera: Float[np.ndarray, "4 4"], instance: int, surface: raster.Surface
) -> ObjectPicture:
    image = image_of(frame)
    camera = raster.Camera(_of(frame.intrinsics, image.shape), T_world_camera)
    estimate = np.isfinite(raster.draw_surfaces(camera, [surface]).depth)
    height, width = image.shape[:2]
    mask = (frame.instances == instance).astype(np.uint8)
    mask = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    rows, columns = _about(estimate | mask)
    share = _WIDTH / (columns.stop - columns.start)
    image = cv2.resize(image[rows, columns], None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    for shown, color, thickness in ((mask, _MASK, 1), (estimate, _OUTLINE, 2)):
        part = cv2.resize(
            shown[rows, columns].astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_LINEAR
        )
        contours, _ = cv2.findContours((part > 0.5).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, contours, -1, color, thickness, cv2.LINE_AA)
    return ObjectPicture(frame.name, image)


def image_of(frame: Frame) -> UInt8[np.ndarray, "h w 3"]:
    """Its colours; of a frame without any, its depth in greys."""
    if frame.color is not None:
        return frame.color.copy()
    depth = known_depth(frame)
    near, far = np.percentile(depth[depth > 0], (2, 98)) if depth.any() else (0, 1)
    grey = np.where(depth > 0, 230 - 190 * np.clip((depth - near) / max(far - near, 1e-6), 0, 1), 0)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def known_depth(frame: Frame) -> Float[np.ndarray, "h w"]:
    """Metres, 0 where there is none, whatever the frame has there: NaN, infinity, or less than 0."""
    return np.where(np.isfinite(frame.depth) & (frame.depth > 0), frame.depth, 0.0)


def _of(intrinsics: Intrinsics, shape: Sequence[int]) -> Intrinsics:
    """The same camera with the colour image's pixels; pixel centres lie at integers."""
    x, y = shape[1] / intrinsics.width, shape[0] / intrinsics.height
    return Intrinsics(
        intrinsics.fx * x, intrinsics.fy * y, (intrinsics.cx + 0.5) * x - 0.5, (intrinsics.cy + 0.5) * y - 0.5,
        shape[1], shape[0],
    )  # fmt: skip


def _about(shown: Bool[np.ndarray, "h w"]) -> tuple[slice, slice]:
    """Rows and columns about what is shown; all of them where it is nothing."""
    whole = shown if shown.any() else ~shown
    ends = [np.flatnonzero(whole.any(axis=axis))[[0, -1]] for axis in (1, 0)]
    margin = int(_MARGIN * max(np.ptp(each) for each in ends)) + 2
    rows, columns = (
        slice(max(0, low - margin), min(size, high + margin + 1))
        for (low, high), size in zip(ends, shown.shape, strict=True)
    )
    return rows, columns
