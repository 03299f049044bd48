"""The scan under the map: its points, and its frames with colours, depth, masks and the estimates' outlines."""

from collections.abc import Callable, Mapping, Sequence

import cv2
import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, Int, UInt8

from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Frame, FrameSource
from objgraph.show import raster
from objgraph.show.rerun_view import paths
from objgraph.show.rerun_view.shapes import Rgb, Surface, camera_pose, path_line, pinhole

_QUALITY = 85
"""Of JPEG."""
_MILLIMETRES = 1000.0
"""Depth units in a metre."""
_RADIUS = 0.003
"""Of points, metres."""
_GREY = 150


def log_points(
    recording: rr.RecordingStream,
    points_world: Float[np.ndarray, "n 3"],
    colors: Float[np.ndarray, "n 3"] | None,
) -> None:
    """The scan's finite points; `colors` are RGB in 0..1. Raises MapError where the two do not fit."""
    points, colors = raster.finite_points(points_world, colors)
    rgb = [_GREY] * 3 if colors is None else np.round(255 * colors).astype(np.uint8)
    recording.log(paths.POINTS, rr.Points3D(points, colors=rgb, radii=_RADIUS), static=True)


def log_frames(
    recording: rr.RecordingStream,
    object_map: ObjectMap,
    frames: FrameSource,
    most: int,
    tell: Callable[[str, int, int], None] | None = None,
) -> None:
    """Frames on the timeline `frame` by their place in the scan: about `most`, and those that objects were mapped from."""
    classes = {entry.id: 1 + i for i, entry in enumerate(object_map.objects)}
    surfaces = [
        (Surface(entry.vertices, entry.faces), paths.object_color(i))
        for i, entry in enumerate(object_map.objects)
        if entry.vertices is not None and entry.faces is not None
    ]
    annotate(recording, [entry.name for entry in object_map.objects])
    chosen = _chosen(object_map.objects, frames, most)
    eyes = []
    for done, i in enumerate(chosen, 1):
        frame = frames[i]
        recording.set_time(paths.FRAME, sequence=i)
        log_frame(recording, frame, classes)
        recording.log(paths.OUTLINES, outlines(frame, surfaces))
        eyes.append(frame.T_world_camera[:3, 3])
        if tell is not None:
            tell("reading frames", done, len(chosen))
    recording.reset_time()
    recording.log(paths.TRAJECTORY, path_line(np.array(eyes)), static=True)


def log_frame(recording: rr.RecordingStream, frame: Frame, classes: Mapping[int, int]) -> None:
    """One frame at the recording's time; `classes` gives the viewer's class of each instance that is shown."""
    recording.log(paths.CAMERA, camera_pose(frame.T_world_camera), pinhole(frame.intrinsics))
    recording.log(paths.CAMERA, rr.AnyValues(name=frame.name))
    if frame.color is not None:
        recording.log(paths.COLOR, rr.EncodedImage(contents=_jpeg(frame), media_type="image/jpeg"))
    depth = np.round(_MILLIMETRES * frame.depth)
    depth = np.where((depth > 0) & (depth < 2**16), depth, 0).astype(np.uint16)
    recording.log(
        paths.DEPTH, rr.EncodedDepthImage(_encoded(".png", depth), media_type="image/png", meter=_MILLIMETRES)
    )
    recording.log(paths.MASKS, rr.SegmentationImage(_class_image(frame.instances, classes), opacity=0.4))


def annotate(recording: rr.RecordingStream, names: Sequence[str]) -> None:
    """Class 0 of masks is no object, which is not drawn; those from 1 on have these names, and their objects' colours."""
    shown = [rr.AnnotationInfo(1 + i, name, paths.object_color(i)) for i, name in enumerate(names)]
    nothing = rr.AnnotationInfo(0, "no object", (0, 0, 0, 0))
    recording.log("/", rr.AnnotationContext([nothing, *shown]), static=True)


def _chosen(entries: Sequence[MappedObject], frames: FrameSource, most: int) -> list[int]:
    """Frames evenly over the scan, and those that objects were mapped from."""
    names = {view for entry in entries for view in entry.views}
    used = [i for i, name in enumerate(frames.names) if name in names]
    evenly = np.linspace(0, len(frames) - 1, min(most, len(frames))).astype(int)
    return sorted({*used, *evenly.tolist()})


def outlines(frame: Frame, surfaces: Sequence[tuple[Surface, Rgb]]) -> rr.LineStrips2D:
    """Of the surfaces that the frame looks at, be they hidden or not, each in its colour."""
    camera = raster.Camera(frame.intrinsics, frame.T_world_camera)
    strips, colors = [], []
    for (vertices, faces), rgb in surfaces:
        if not _may_be_seen(camera, vertices):
            continue
        drawn = raster.draw_surfaces(camera, [raster.Surface(vertices, faces, np.ones_like(vertices))])
        found = _contours(np.isfinite(drawn.depth))
        strips += found
        colors += [rgb] * len(found)
    return rr.LineStrips2D(strips, colors=colors, radii=1.0, draw_order=30.0)


def _may_be_seen(camera: raster.Camera, p_world: Float[np.ndarray, "v 3"]) -> bool:
    u, v, z = raster.project(camera, p_world).T
    inside = (z > 0) & (u > -0.5) & (v > -0.5)
    return bool((inside & (u < camera.intrinsics.width - 0.5) & (v < camera.intrinsics.height - 0.5)).any())


def _contours(seen: Bool[np.ndarray, "h w"]) -> list[Float[np.ndarray, "n 2"]]:
    """Closed outlines in the viewer's pixels, which begin at their corners."""
    found, _ = cv2.findContours(seen.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    return [np.concatenate([each, each[:1]])[:, 0] + 0.5 for each in found if len(each) > 2]


def _class_image(instances: Int[np.ndarray, "h w"], classes: Mapping[int, int]) -> Int[np.ndarray, "h w"]:
    image = np.zeros(instances.shape, np.uint16)
    for instance, number in classes.items():
        image[instances == instance] = number
    return image


def _jpeg(frame: Frame) -> bytes:
    """Its colours with the depth's pixels."""
    assert frame.color is not None
    size = (frame.intrinsics.width, frame.intrinsics.height)
    rgb: UInt8[np.ndarray, "h w 3"] = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
    return _encoded(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))


def _encoded(ending: str, image: np.ndarray, options: Sequence[int] = ()) -> bytes:
    done, data = cv2.imencode(ending, image, list(options))
    assert done
    return data.tobytes()
