"""The guides' Python is run, on a small sample of the project's own."""

import shutil
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

import objgraph
from objgraph.datasets import registry, scannet
from objgraph.datasets.files import decode_depth
from objgraph.slam.odometry import OdometryNoise
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.conftest import REPOSITORY
from tests.test_docs import python_of

GUIDES = REPOSITORY / "docs" / "guides"
FRAMES = 6
CHAIR = 2


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> objgraph.Scan:
    """The sample's room in few and small frames, and of its objects one chair."""
    config = SampleConfig(camera=CameraConfig(frames=FRAMES, width=240, height=180))
    whole = scannet.load(generate_sample(tmp_path_factory.mktemp("sample") / "sample", config) / "scannet")
    chair = [each for each in whole.instances if each.id == CHAIR]
    return objgraph.Scan(whole.name, whole.frames, tuple(chair), whole.up_world)


def run(page: str, containing: str, **given: Any) -> dict[str, Any]:
    """The names that the page's block with these words defines; `given` is what its text says is there."""
    (block,) = [each for each in python_of(GUIDES / page) if containing in each]
    names = {"__name__": page, **given}
    exec(compile(block, page, "exec"), names)
    return names


def chair_graph(scan: objgraph.Scan) -> tuple[objgraph.ObjectGraph, objgraph.ObjectHandle]:
    frame = scan.frames[0]
    view = objgraph.observe(frame, CHAIR)
    objects = objgraph.ObjectGraph(
        gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=scan.up_world, floor=0.0
    )
    chair = objects.add_object("chair", view)
    objects.observe(chair, view, gtsam.Pose3(frame.T_world_camera))
    objects.optimize()
    return objects, chair


def test_covariances(scan, capsys):
    names = run("covariances.md", "look_at")
    names["look_at"](*chair_graph(scan))
    printed = capsys.readouterr().out
    assert all(axis in printed for axis in ("rotation_x", "translation_z", "log_scale_y", "code_63"))


def test_calibrate(tmp_path, monkeypatch, capsys):
    saved = REPOSITORY / "tests" / "objgraph" / "maps" / "format_7"
    shutil.copytree(saved, tmp_path / "out" / "map")
    monkeypatch.chdir(tmp_path)
    run("calibrate.md", "entry.trust")
    assert capsys.readouterr().out == "chair likely 0.75 little of its surface is seen\n"


def test_a_folder_is_written(scan, tmp_path):
    """What the guide's functions write is the scan that they were given, in place of an earlier one with wrong poses."""
    names = run("datasets.md", "write_frame")
    intrinsics = scan.frames[0].intrinsics
    for pose_of in (np.linalg.inv, np.asarray):
        for index in range(FRAMES):
            frame = scan.frames[index]
            color = np.full((*frame.depth.shape, 3), 100, np.uint8)
            pose = pose_of(frame.T_world_camera)
            names["write_frame"](tmp_path, f"{index:03}", frame.depth, frame.instances, pose, color)
    camera = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    names["write_scan"](tmp_path, *camera, {CHAIR: "chair"}, scan.up_world)
    read = objgraph.load_scan("folder", tmp_path)
    assert [(each.id, each.category) for each in read.instances] == [(CHAIR, "chair")]
    for index in range(FRAMES):
        frame, written = scan.frames[index], read.frames[index]
        np.testing.assert_allclose(written.depth, frame.depth, atol=6e-4)
        np.testing.assert_allclose(written.T_world_camera, frame.T_world_camera, atol=1e-6)
        np.testing.assert_array_equal(written.instances, frame.instances)


def test_depth_that_16_bits_do_not_hold_is_none(tmp_path):
    """A simulator's sky, and what a sensor has not measured."""
    names = run("datasets.md", "write_frame")
    depth = np.array([[1000.0, 70.0, np.nan, np.inf, -1.0, 0.0, 2.0, 64.9]])
    names["write_frame"](
        tmp_path, "0", depth, np.zeros((1, 8), int), np.eye(4), np.zeros((1, 8, 3), np.uint8)
    )
    written = (tmp_path / "depth" / "0.png").read_bytes()
    np.testing.assert_allclose(decode_depth(written, "0.png", 1000.0), [[0, 0, 0, 0, 0, 0, 2, 64.9]])


def test_a_format_of_ones_own(scan, tmp_path, monkeypatch):
    (tmp_path / "room").mkdir()
    monkeypatch.setattr(registry, "_LOADERS", dict(registry._LOADERS))
    names = run("datasets.md", "register(")
    names["read_frames"] = lambda _: [scan.frames[index] for index in range(FRAMES)]
    read = objgraph.load_scan("mine", tmp_path)
    assert (read.name, len(read.frames)) == ("room", FRAMES)


def test_map_in_python(scan, tmp_path, monkeypatch, capsys):
    """Of the data set that the guide names, the sample stands in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(objgraph, "load_scan", lambda *_: scan)
    names = run("map.md", "map_scan")
    assert "chair" in capsys.readouterr().out
    assert len(objgraph.ObjectMap.load("out/scene0470").mapped) == len(names["object_map"].mapped) == 1


@pytest.fixture(scope="module")
def grown(scan) -> Any:
    names = run("slam.md", "def build")
    frames = [scan.frames[index] for index in range(FRAMES)]
    return names["build"](frames, [list(scan.instances)] * FRAMES, scan.up_world, 0.0)


def test_frame_by_frame(grown):
    assert [entry.name.split()[0] for entry in grown.objects] == ["chair"]


def test_recorded_frame_by_frame(scan, tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason="the extra [view] is not installed")
    monkeypatch.chdir(tmp_path)
    stream = [(scan.frames[index], []) for index in range(2)]
    run("map.md", "log_incremental", stream=stream, objects=objgraph.IncrementalObjectGraph(scan.up_world))
    assert Path("room.rrd").stat().st_size > 1000


def test_a_smoother_of_ones_own(scan):
    take_in = run("slam.md", "def take_in")["take_in"]
    smoother = gtsam.ISAM2()
    objects = objgraph.ObjectFrontEnd(smoother, scan.up_world, floor=0.0)
    before = None
    for index in range(FRAMES):
        frame = scan.frames[index]
        pose = gtsam.Pose3(frame.T_world_camera)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        values.insert(X(index), pose)
        if before is None:
            graph.push_back(gtsam.PriorFactorPose3(X(0), pose, gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
        else:
            motion = before.between(pose)
            graph.push_back(
                gtsam.BetweenFactorPose3(X(index - 1), X(index), motion, OdometryNoise().model(motion))
            )
        smoother.update(graph, values)
        before = pose
        take_in(smoother, objects, frame, list(scan.instances), X(index))
    assert [entry.name.split()[0] for entry in objects.objects] == ["chair"]


def test_many_scenes(scan, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        objgraph.ObjectMap(name, (), scan.up_world).save(Path("out/maps") / name)
    run("many-scenes.md", "ObjectMap.load")
    assert capsys.readouterr().out.splitlines() == ["a 0 of 0", "b 0 of 0"]
