"""Poses by registration of depth images: against the true ones of a rendered room."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from objgraph.bench.dense_reference import dense_reference
from objgraph.datasets import scannet
from objgraph.errors import EvaluationError
from objgraph.observation.frames import Frame
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample

FRAMES = 24


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> list[Frame]:
    """A few of its frames that overlap."""
    config = SampleConfig(camera=CameraConfig(frames=FRAMES, width=320, height=240))
    scan = scannet.load(generate_sample(tmp_path_factory.mktemp("sample"), config) / "scannet")
    return [scan.frames[k] for k in range(5)]


def moved(frame: Frame, rng: np.random.Generator) -> Frame:
    """Its pose off by about 1 degree and 2 cm."""
    off = gtsam.Pose3.Expmap(np.concatenate([rng.normal(size=3) * 0.01, rng.normal(size=3) * 0.012]))
    return replace(frame, T_world_camera=frame.T_world_camera @ off.matrix())


def error(found: np.ndarray, true: np.ndarray) -> float:
    """Mean distance, metres, by which what is 2 m ahead of the cameras is off."""
    ahead = np.array([0.0, 0.0, 2.0, 1.0])
    return float(np.linalg.norm((found - true) @ ahead, axis=1).mean())


def test_poses_that_are_off_are_found_again(room: list[Frame]):
    true = np.stack([frame.T_world_camera for frame in room])
    rng = np.random.default_rng(0)
    wrong = [room[0], *(moved(frame, rng) for frame in room[1:])]
    given = np.stack([frame.T_world_camera for frame in wrong])

    found = dense_reference(wrong)

    np.testing.assert_allclose(found.T_world_camera[0], true[0], atol=1e-9)
    assert error(given, true) > 0.02
    assert error(found.T_world_camera, true) < 0.2 * error(given, true)
    assert found.spread_m < 0.2 * found.given_spread_m


def test_right_poses_stay(room: list[Frame]):
    found = dense_reference(room)
    assert error(found.T_world_camera, np.stack([f.T_world_camera for f in room])) < 0.005
    assert found.pairs >= len(room) - 1


def test_frames_that_nothing_connects_with_the_first_are_named(room: list[Frame]):
    """Two of them see the same, but not what the others see."""
    away = np.eye(4)
    away[:3, 3] = 100.0
    far = [replace(frame, T_world_camera=away @ frame.T_world_camera) for frame in room[1:3]]
    with pytest.raises(EvaluationError, match=f"frames {room[1].name}, {room[2].name} are not connected"):
        dense_reference([room[0], *far, room[3]])
