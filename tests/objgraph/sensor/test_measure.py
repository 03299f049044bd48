"""What a room's depth and poses are worth: against what was done to them, and as its user would ask."""

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from objgraph.cli.main import main
from objgraph.cli.run_config import read_run
from objgraph.datasets import scannet
from objgraph.errors import DatasetError
from objgraph.maps.pipeline import MappingConfig
from objgraph.observation.frames import Frame, ListedFrames
from objgraph.observation.sampling import SensorNoise
from objgraph.sensor import Sensor, SensorConfig, measure_sensor
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample

ROTATION, TRANSLATION = 0.01, 0.02
FEW = SensorConfig(pairs=25)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project's sample room, small."""
    config = SampleConfig(camera=CameraConfig(frames=40, width=320, height=240))
    return generate_sample(tmp_path_factory.mktemp("sample"), config) / "scannet"


@pytest.fixture(scope="module")
def room(folder: Path) -> list[Frame]:
    scan = scannet.load(folder)
    return [scan.frames[k] for k in range(10)]


@pytest.fixture(scope="module")
def exact(room: list[Frame]) -> Sensor:
    return measure_sensor(ListedFrames(room), FEW)


def moved(frame: Frame, rng: np.random.Generator) -> Frame:
    off = gtsam.Pose3.Expmap(rng.normal(size=6) * np.repeat([ROTATION, TRANSLATION], 3))
    return replace(frame, T_world_camera=frame.T_world_camera @ off.matrix())


def test_errors_of_poses_are_measured(room: list[Frame], exact: Sensor):
    rng = np.random.default_rng(0)
    wrong = measure_sensor(ListedFrames([moved(frame, rng) for frame in room]), FEW)
    assert wrong.pose_sigma == pytest.approx((ROTATION, TRANSLATION), rel=0.4)
    assert exact.pose_sigma[0] < 0.3 * ROTATION
    assert exact.pose_sigma[1] < 0.3 * TRANSLATION


def test_what_a_patch_is_off_is_measured(room: list[Frame], exact: Sensor):
    """Waves of 80 cm on all that is seen, other ones in each frame."""
    rng = np.random.default_rng(1)
    depths = np.array([1.5, 2.5])
    before = exact.noise(depths)
    waved = []
    for frame in room:
        v, u = np.indices(frame.depth.shape)
        across = 2 * np.pi * frame.depth / (0.8 * frame.intrinsics.fx)
        wave = np.sin(u * across + rng.uniform(0, 6)) * np.sin(v * across + rng.uniform(0, 6))
        waved.append(replace(frame, depth=np.where(frame.depth > 0, frame.depth * (1 + 0.01 * wave), 0.0)))
    after = measure_sensor(ListedFrames(waved), FEW).noise(depths)
    # a product of two waves of 1 % is half as much; registration takes some of it for motion
    assert (after > 1.5 * before).all()
    assert (after > 0.4 * 0.005 * depths).all()
    assert (after < 1.3 * 0.005 * depths).all()


def test_too_little_overlap_is_said(room: list[Frame]):
    with pytest.raises(DatasetError, match="overlap by 35%, 5 are due: look at more frames"):
        measure_sensor(ListedFrames(room[:2]), SensorConfig(frames=2))
    for count, how in ((2, "these are all: record more"), (3, "--frames")):
        with pytest.raises(DatasetError, match=rf"look at more frames \({how}\), or from nearer"):
            measure_sensor(ListedFrames(room[:count]), SensorConfig(frames=2))


def test_depth_that_is_too_far_is_said(room: list[Frame], capfd: pytest.CaptureFixture):
    far = [replace(frame, depth=np.full_like(frame.depth, 5.0)) for frame in room[:3]]
    some = [replace(room[0], depth=np.where(room[0].depth > 2, 5.0, room[0].depth)), *far]
    none = [replace(frame, depth=np.zeros_like(frame.depth)) for frame in far]
    near = np.count_nonzero((room[0].depth > 0) & (room[0].depth <= 2)) / (4 * room[0].depth.size)
    for frames, share in ((far, 0.0), (some, near), (none, 0.0), ([], 0.0)):
        with pytest.raises(DatasetError, match=f"or from nearer: {share:.0%} of the depth is within 3.5 m"):
            measure_sensor(ListedFrames(frames), FEW)
    assert "Open3D" not in "".join(capfd.readouterr())


def test_a_map_takes_what_is_written(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    out = tmp_path / "sensor.json"
    words = ["--dataset", "scannet", "--root", str(folder), "--out", str(out)]
    assert main(["sensor", *words, "--frames", "12", "--pairs", "15"]) == 0
    said = capsys.readouterr().out
    assert "a camera's rotation" in said
    assert "15 pairs" in said
    written = json.loads(out.read_text())["settings"]
    run = read_run(out, {"dataset": "scannet", "root": folder}, {})
    assert isinstance(run.settings, MappingConfig)
    assert run.settings.graph.pose_sigma == tuple(written["graph"]["pose_sigma"])
    # the room's sensor is better than the default, which stands for more than the sensor
    assert run.settings.sampling.noise == SensorNoise()


def test_a_worse_sensor_is_told_to_the_map():
    sensor = Sensor(SensorNoise(0.002, 0.006), (0.01, 0.02), 10, 200)
    assert sensor.settings() == {
        "sampling": {"noise": {"base": SensorNoise().base, "quadratic": 0.006}},
        "graph": {"pose_sigma": [0.01, 0.02]},
    }


def test_a_lidar_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture):
    assert main(["sensor", "--dataset", "street", "--out", str(tmp_path / "s.json")]) == 1
    assert "is a LiDAR's" in capsys.readouterr().err
    assert not (tmp_path / "s.json").exists()
