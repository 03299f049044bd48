"""Recordings of what is odd: names that Markdown reads, depths beyond a picture's, steps without a surface."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

pytest.importorskip("rerun", reason="install it with: pip install 'objgraph[view]'")

from objgraph.errors import SolveError
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.show import rerun_view
from objgraph.show.rerun_view import iterations
from objgraph.show.rerun_view.scan import log_frame
from tests.objgraph.maps.map_cases import UP
from tests.objgraph.show.test_rerun_view import written
from tests.toys import toy_frame, toy_prior, toy_state


def test_a_name_is_no_markdown_where_remarks_are_told(tmp_path):
    object_map = ObjectMap("x", (MappedObject(1, "*bed*", "failed", "why"),), UP)
    object_map.save(tmp_path)
    recording = rerun_view.new_recording("x")
    rerun_view.log_objects(recording, object_map, tmp_path)
    assert r"- \*bed\* 1: why" in written(recording, tmp_path).text("/table")


def test_a_step_without_a_surface_is_told_by_its_cost_alone(tmp_path, monkeypatch):
    draw = iterations.log_state

    def log_state(recording, path, prior, state, label, *rest):
        if label == "step 1":
            raise SolveError("the code has no surface")
        return draw(recording, path, prior, state, label, *rest)

    monkeypatch.setattr(iterations, "log_state", log_state)
    recording = rerun_view.new_recording("x")
    steps = [iterations.Step(toy_state(), cost) for cost in (None, 3.0, 2.0)]
    rerun_view.log_iterations(recording, toy_prior(), steps)
    found = written(recording, tmp_path)
    assert [*found.values["/world/iterate/box", "half_sizes"]] == [0, 2]
    assert [*found.values["/cost", "scalars"]] == [1, 2]


def test_depth_beyond_what_a_picture_holds_is_none(tmp_path):
    frame = toy_frame([toy_state()], 0.0)
    depth = frame.depth.copy()
    depth[0, :4] = 65.535, 70.0, np.inf, np.nan
    recording = rerun_view.new_recording("x")
    recording.set_time("frame", sequence=0)
    log_frame(recording, replace(frame, depth=depth), {})
    (data,) = written(recording, tmp_path).values["/world/camera/depth", "blob"][0]
    image = cv2.imdecode(np.array(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image[0, :4].tolist() == [65535, 0, 0, 0]
