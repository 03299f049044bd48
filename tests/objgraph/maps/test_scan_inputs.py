"""Scans and settings that cannot be mapped are named before any work."""

from dataclasses import replace

import numpy as np
import pytest

from objgraph.errors import ConfigError, ObservationError
from objgraph.maps.pipeline import MappingConfig, map_scan
from objgraph.observation.frames import Instance, ListedFrames, Scan
from objgraph.observation.lidar.frame import LidarFrame
from tests.toys import toy_frame, toy_state

UP = np.array([0.0, 0.0, 2.0])
SCAN = Scan("room", ListedFrames([toy_frame([toy_state()], 0.3)]), (Instance(1, "chair"),), UP)


def test_up_is_made_a_unit_vector():
    assert SCAN.up_world.tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": ListedFrames([])}, "scan room has no frame"),
        ({"frames": ListedFrames([None])}, "frame 0 of the scan must be of type Frame"),  # type: ignore[list-item]
        ({"frames": []}, "scan room: frames must be of type FrameSource"),
        ({"instances": (1,)}, r"scan room: instances\[0\] must be of type Instance"),
        ({"up_world": np.zeros(3)}, "scan room: up_world must have a direction"),
    ],
)
def test_a_scan_that_is_none_is_named(changes, message):
    with pytest.raises(ObservationError, match=message):
        map_scan(replace(SCAN, **changes))


@pytest.mark.parametrize(
    ("id", "category"), [(0, "chair"), (-3, "chair"), (1.5, "chair"), (1, ""), (1, None)]
)
def test_an_object_without_a_number_or_a_name_is_refused(id, category):
    with pytest.raises(ObservationError, match=r"object|id of a chair"):
        Instance(id, category)


@pytest.mark.parametrize(
    "make",
    [
        lambda name: replace(SCAN, name=name),
        lambda name: replace(toy_frame([toy_state()], 0.3), name=name),
        lambda name: Instance(1, name),
        lambda name: LidarFrame(name, np.zeros((1, 3)), np.eye(4), UP, ()),
    ],
)
def test_a_name_that_no_file_could_hold_is_refused_before_any_work(make):
    with pytest.raises(ObservationError, match=r"'Stra\\udcdfe' is no Unicode text; rename it"):
        make("Stra\udcdfe")


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"views": 0}, "MappingConfig.views"),
        ({"mesh_resolution": 10**6}, "MappingConfig.mesh_resolution"),
        ({"estimator": "best"}, "MappingConfig.estimator"),
        ({"priors": "chair"}, "MappingConfig.priors"),
        ({"sampling": {}}, "MappingConfig.sampling"),
    ],
)
def test_a_setting_that_is_none_is_named(changes, name):
    with pytest.raises(ConfigError, match=name):
        MappingConfig(**changes)
