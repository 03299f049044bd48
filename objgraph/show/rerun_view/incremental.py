"""A map that grows: each frame, where its camera is now thought to be, and the objects with their covariance."""

from dataclasses import replace

import numpy as np
import rerun as rr

from objgraph.errors import SolveError
from objgraph.observation.frames import Frame
from objgraph.show.placement import Ellipsoid
from objgraph.show.rerun_view import paths
from objgraph.show.rerun_view.layout import incremental_layout
from objgraph.show.rerun_view.scan import annotate, log_frame, outlines
from objgraph.show.rerun_view.shapes import ELLIPSOID, Surface, ellipsoid_shape, path_line, world_axes
from objgraph.show.rerun_view.states import log_state
from objgraph.show.summary import position_covariance
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.tracked import TrackedObject

_RESOLUTION = 24
"""Cells along an edge of the canonical cube: every object gets a mesh at every frame."""


def log_incremental(objects: IncrementalObjectGraph, frame: Frame, recording: rr.RecordingStream) -> None:
    """What the map has after its `update` with this frame, on the timeline `frame`.

    The camera stands where the map has it. Ellipsoids are of an object's origin by the graph's marginals, which are too
    small; the costs of decoding and of marginals grow with the number of objects.
    """
    keys = [key for key in objects.cameras if objects.system.smoother.has(key)]  # those that a lag has left
    poses = [objects.system.camera_pose(key).matrix() for key in keys]
    if len(objects.cameras) == 1:
        recording.send_blueprint(incremental_layout())
        annotate(recording, ())
        up_world = objects.system.builder.up_world
        assert up_world is not None  # the map's constructor wants it
        recording.log(paths.WORLD, world_axes(up_world), static=True)
    recording.set_time(paths.FRAME, sequence=len(objects.cameras) - 1)
    frame = replace(frame, T_world_camera=poses[-1])
    masks = [int(each) for each in np.unique(frame.instances) if 0 < each <= np.iinfo(np.uint16).max]
    log_frame(recording, frame, {each: each for each in masks})
    recording.log(paths.TRAJECTORY, path_line(np.array(poses)[:, :3, 3]))
    surfaces = []
    for i, entry in enumerate(objects.objects):
        surface = _log_tracked(objects, entry, i, recording)
        if surface is not None:
            surfaces.append((surface, paths.object_color(i)))
    recording.log(paths.OUTLINES, outlines(frame, surfaces))
    recording.reset_time()


def _log_tracked(
    objects: IncrementalObjectGraph, entry: TrackedObject, index: int, recording: rr.RecordingStream
) -> Surface | None:
    """Its mesh, box and ellipsoid; None where its code has no surface now."""
    state, path = objects.state(entry), paths.object_path(entry.name)
    T_world_object = state.T_world_object.matrix()
    covariance = position_covariance(T_world_object, objects.marginals(entry).rigid)
    recording.log(
        f"{path}/ellipsoid", ellipsoid_shape(Ellipsoid.of(T_world_object[:3, 3], covariance), ELLIPSOID)
    )
    sigma_cm = 100 * np.sqrt(np.trace(covariance))
    recording.log(f"{paths.SIGMA}/{rr.escape_entity_path_part(entry.name)}", rr.Scalars(sigma_cm))
    try:
        return log_state(
            recording, path, entry.prior, state, entry.name, paths.object_color(index), _RESOLUTION
        )
    except SolveError:
        return None
