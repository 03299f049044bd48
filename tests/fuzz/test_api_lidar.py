"""Scans of a LiDAR, with arguments that are wrong."""

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from objgraph.maps.lidar import LidarMappingConfig, map_lidar
from objgraph.maps.lidar_task import DetectorNoise
from objgraph.observation import observe_lidar, road_under
from objgraph.observation.lidar.frame import Detection, LidarFrame, Picture
from objgraph.observation.lidar.observe import LidarSamplingConfig
from objgraph.observation.lidar.road import RoadConfig
from tests.fuzz.api_cases import (
    BRIEF,
    FRAME,
    STATE,
    VIEWS,
    patched,
)
from tests.fuzz.arguments import arguments, settings_of
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.graph.graph_cases import UP
from tests.toys import INTRINSICS


def lidar_parts() -> dict[str, Any]:
    view = VIEWS[0]
    T = np.eye(4)
    detection = Detection(1, "chair", STATE.T_world_object.matrix(), np.array([0.7, 1.0, 0.7]))
    return {
        "name": "0",
        "p_lidar": view.points_camera,
        "T_world_lidar": view.T_world_camera.matrix() @ T,
        "up_world": UP,
        "detections": (detection,),
    }


LIDAR = lidar_parts()
DETECTION = LIDAR["detections"][0]
PICTURE: dict[str, Any] = {
    "color": np.zeros((240, 320, 3), np.uint8),
    "intrinsics": INTRINSICS,
    "T_world_camera": FRAME.T_world_camera,
    "instances": FRAME.instances,
}


@fuzzed
@given(data=st.data())
def test_lidar_scans(data):
    others = (replace(DETECTION, id=2),)
    given = data.draw(arguments(LIDAR, {"picture": Picture(**PICTURE), "others": others}))
    picture = data.draw(arguments(PICTURE))
    detection = data.draw(arguments(vars(DETECTION)))

    def use(**parts: Any) -> None:
        frame = LidarFrame(**(LIDAR | parts))
        road_under(frame.p_world, frame.up_world, DETECTION)
        observe_lidar(frame, frame.detection(1))
        config = LidarMappingConfig(mesh_resolution=12, solver=BRIEF, heading_modes=None)
        map_lidar(frame, config)

    patched(lambda: attempt(use, **given))
    patched(lambda: attempt(lambda: use(picture=Picture(**picture))))
    patched(lambda: attempt(lambda: use(detections=(Detection(**detection),))))


@fuzzed
@given(data=st.data())
def test_settings_of_lidar_scans(data):
    kind = data.draw(st.sampled_from([LidarSamplingConfig, RoadConfig, DetectorNoise, LidarMappingConfig]))
    given = data.draw(settings_of(kind))
    names = {LidarSamplingConfig: "sampling", RoadConfig: "road", DetectorNoise: "detector"}

    def use() -> None:
        cheap: dict[str, Any] = {"mesh_resolution": 12, "solver": BRIEF, "heading_modes": None}
        if kind is LidarMappingConfig:
            cheap |= given
        else:
            cheap["task"] = replace(LidarMappingConfig().task, **{names[kind]: kind(**given)})
        map_lidar(LidarFrame(**LIDAR), LidarMappingConfig(**cheap))

    patched(lambda: attempt(use))
