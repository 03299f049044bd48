"""Poses of a camera that is turned more than moved, and depth that is infinite where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from objgraph.datasets import scannet
from objgraph.doctor.poses import examine_poses
from objgraph.doctor.seen import look
from objgraph.observation.frames import Frame, ListedFrames, Scan
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.objgraph.datasets.dataset_folders import frames_of

CAMERA = CameraConfig(frames=8, width=160, height=120, sweep_rad=0.06)
"""Within 0.3 m."""


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Scan:
    return scannet.load(
        generate_sample(tmp_path_factory.mktemp("slow"), SampleConfig(camera=CAMERA)) / "scannet"
    )


@pytest.fixture(scope="module")
def frames(scan: Scan) -> list[Frame]:
    return frames_of(scan)


def findings(scan: Scan, frames: list[Frame]):
    return examine_poses(look(replace(scan, frames=ListedFrames(frames)))).findings


def placed(frame: Frame, place: np.ndarray) -> Frame:
    T = frame.T_world_camera.copy()
    T[:3, 3] = place
    return replace(frame, T_world_camera=T)


@pytest.mark.parametrize("sigma", [0.1, 0.2])
def test_noise_is_no_other_unit(scan, frames, sigma):
    """Though poses that are all in one place agree better than what is there."""
    rng = np.random.default_rng(0)
    noisy = [placed(frame, frame.T_world_camera[:3, 3] + sigma * rng.normal(size=3)) for frame in frames]
    (finding,) = findings(scan, noisy)
    assert "poses and depth disagree" in finding.what


def test_a_short_path_in_centimetres(scan, frames):
    """Cameras are not so far apart that this alone would tell."""
    assert findings(scan, frames) == ()
    larger = [placed(frame, 100 * frame.T_world_camera[:3, 3]) for frame in frames]
    (finding,) = findings(scan, larger)
    assert "the poses look written in centimetres" in finding.what
    assert finding.do == "write their translations in metres"


def test_infinite_depth_is_none(scan, frames):
    """As it is where a custom loader or a simulator says that nothing came back."""
    far = [np.where(frame.depth > 2.5, np.inf, frame.depth) for frame in frames]
    shown = [replace(frame, depth=depth) for frame, depth in zip(frames, far, strict=True)]
    without = [
        replace(frame, depth=np.where(np.isfinite(depth), depth, 0.0))
        for frame, depth in zip(frames, far, strict=True)
    ]
    rows = [examine_poses(look(replace(scan, frames=ListedFrames(each)))).rows for each in (shown, without)]
    assert rows[0] == rows[1]
    assert rows[0][1][0] == "agreement"
