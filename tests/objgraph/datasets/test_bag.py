"""Bags: every kind and form gives back what was written, and what cannot be read is named."""

import json
import logging
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from objgraph.cli.main import main
from objgraph.datasets import Trajectory, load_scan, scenes, write_tum
from objgraph.errors import DatasetError
from objgraph.segment.mask2former import Segment, Segmenter
from tests.objgraph.datasets.bag_files import (
    CAMERA,
    COLOR,
    DEPTH,
    INFO,
    KINDS,
    START,
    STEP,
    BagWriter,
    millimetres,
    name_of,
    write_frames,
    write_masks,
    write_poses,
    write_recording,
)
from tests.objgraph.datasets.dataset_folders import assert_scans_equal, frames_of, pose, toy_scan
from tests.objgraph.segment.test_segment import Network


def load(root, **options):
    return load_scan("bag", root, **options)


def bag_of(folder, write, how="pose"):
    """A bag whose images another function writes, with poses and masks; gives the folder."""
    with BagWriter(folder / "run.bag") as bag:
        stamps = write(bag)
        write_poses(bag, toy_scan(), stamps, how)
    write_masks(folder, toy_scan(), stamps)
    return folder


@pytest.mark.parametrize("how", ["tf", "odometry", "pose"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_is_read(tmp_path, kind, how):
    path = write_recording(tmp_path / "robot", toy_scan(), kind, how)
    scan = load(tmp_path / "robot")
    assert_scans_equal(scan, toy_scan(), 0)
    assert scan.frames.names == ("1305031102.160407123", "1305031102.193740456", "1305031102.227073789")
    assert_scans_equal(load(path), scan, 0)
    if kind != "bag":  # and the file without the folder that ROS 2 puts it into
        (path / f"run.{kind}").rename(tmp_path / "robot" / f"alone.{kind}")
        assert_scans_equal(load(tmp_path / "robot" / f"alone.{kind}"), toy_scan(), 0)


@pytest.mark.parametrize(
    ("depth", "color"),
    [("32FC1", "bgr8"), ("compressedDepth", "rgba8"), ("png", "bgra8"), ("16UC1", "jpeg")],
)
def test_every_form_of_images_is_read(tmp_path, depth, color):
    write_recording(tmp_path, toy_scan(), depth=depth, color=color)
    for mine, theirs in zip(frames_of(load(tmp_path)), frames_of(toy_scan()), strict=True):
        np.testing.assert_allclose(mine.depth, theirs.depth, atol=1e-6)
        assert mine.color is not None
        assert theirs.color is not None
        np.testing.assert_allclose(mine.color.astype(int), theirs.color, atol=2 if color == "jpeg" else 0)


def test_floats_compressed_as_inverse_depth_come_back(tmp_path):
    from tests.objgraph.datasets.dataset_folders import png

    a, b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0

    def write(bag):
        for k, frame in enumerate(frames_of(toy_scan())):
            with np.errstate(divide="ignore"):
                raw = np.where(frame.depth > 0, a / frame.depth + b, 0)
            head = bytes(4) + np.array([a, b], "<f4").tobytes()
            data = head + png(np.round(raw).astype(np.uint16))
            bag.compressed(
                f"{DEPTH}/compressedDepth", START + k * STEP, CAMERA, "32FC1; compressedDepth png", data
            )
            bag.info(INFO, START, CAMERA, frame.intrinsics)
        return [START + k * STEP for k in range(3)]

    scan = load(bag_of(tmp_path, write))
    for mine, theirs in zip(frames_of(scan), frames_of(toy_scan()), strict=True):
        np.testing.assert_allclose(mine.depth, theirs.depth, atol=1e-3)
        assert mine.color is None


def test_poses_are_between_those_before_and_after(tmp_path):
    scan = toy_scan(2)
    with BagWriter(tmp_path / "run.bag") as bag:
        stamps = write_frames(bag, scan)
        for k in range(2):  # one 20 ms before the first frame, one 60 ms after it
            bag.pose("/camera_pose", START - 20_000_000 + 80_000_000 * k, "map", pose(4 * k))
    write_masks(tmp_path, scan, stamps)
    angle = 0.1 + 0.4 * STEP / 80e6
    between = np.eye(4)
    between[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    between[:3, 3] = [angle, 0, 1]
    poses = [frame.T_world_camera for frame in frames_of(load(tmp_path))]
    np.testing.assert_allclose(poses[0], pose(1), atol=1e-6)  # toy poses turn and move evenly
    np.testing.assert_allclose(poses[1], between, atol=1e-5)  # seconds as floats end at 0.2 microseconds
    with pytest.raises(
        DatasetError, match=r"none of the 2 frames .* near enough in time \(in Python: max_difference\)"
    ):
        load(tmp_path, max_difference=0.05)


def test_frames_outside_of_the_poses_are_left_out(tmp_path, caplog):
    with BagWriter(tmp_path / "run.bag") as bag:
        stamps = write_frames(bag, toy_scan())
        write_poses(bag, toy_scan(2), stamps[:2], "tf")
    write_masks(tmp_path, toy_scan(), stamps)
    assert load(tmp_path).frames.names == tuple(map(name_of, stamps[:2]))
    assert "1 of 3 frames have no pose" in caplog.text


def test_a_trajectory_takes_the_place_of_the_poses(tmp_path):
    write_recording(tmp_path, toy_scan())
    stamps = np.array([START + k * STEP for k in range(3)]) / 1e9
    write_tum(tmp_path / "slam.txt", Trajectory(np.round(stamps, 5), np.array([pose(5)] * 3)))
    scan = load(tmp_path, trajectory=tmp_path / "slam.txt")
    assert len(scan.frames) == 3
    np.testing.assert_allclose(scan.frames[2].T_world_camera, pose(5), atol=1e-9)
    content = json.loads((tmp_path / "instances.json").read_text())
    (tmp_path / "instances.json").write_text(json.dumps({"instances": content["instances"]}))
    np.testing.assert_array_equal(load(tmp_path).up_world, [0, 0, 1])
    with pytest.raises(DatasetError, match="'up_world' is missing"):  # nobody says what a file's world is
        load(tmp_path, trajectory=tmp_path / "slam.txt")


def test_the_world_is_the_topmost_or_the_one_named(tmp_path, caplog):
    write_recording(tmp_path, toy_scan())
    assert f"({CAMERA} < base_link < odom < map)" in (load(tmp_path) and caplog.text)
    turned = load(tmp_path, world_frame="odom").frames[0].T_world_camera
    assert not np.allclose(turned, pose(0))
    np.testing.assert_allclose(turned[2], pose(0)[2], atol=1e-9)  # odom is turned about z
    with pytest.raises(DatasetError, match=r"where the camera .* was in earth; tf has .* < map"):
        load(tmp_path, world_frame="earth")


@pytest.mark.parametrize(("child", "named"), [("base_link", "base_link"), ("", "without a name")])
def test_odometry_of_a_frame_that_the_camera_is_not_on_is_no_pose(tmp_path, child, named):
    with BagWriter(tmp_path / "run.bag") as bag:
        stamps = write_frames(bag, toy_scan())
        for k, stamp in enumerate(stamps):
            bag.pose("/odom", stamp, "odom", pose(k), child)
    write_masks(tmp_path, toy_scan(), stamps)
    with pytest.raises(DatasetError, match=rf"/odom is of frame {named}, .* the camera's, {CAMERA}"):
        load(tmp_path)


@pytest.mark.parametrize("has_odometry", [False, True])
def test_joints_that_move_are_no_world_where_odometry_says_more(tmp_path, has_odometry):
    with BagWriter(tmp_path / "run.bag") as bag:
        stamps = write_frames(bag, toy_scan())
        for k, stamp in enumerate(stamps):
            bag.tf("/tf", stamp, CAMERA, "base_link", pose(k))
            if has_odometry:
                bag.pose("/odom", stamp, "start", pose(5), "base_link")
    write_masks(tmp_path, toy_scan(), stamps)
    expected = pose(5) @ pose(1) if has_odometry else pose(1)
    np.testing.assert_allclose(load(tmp_path).frames[1].T_world_camera, expected, atol=1e-9)


def test_of_several_topics_of_poses_one_must_be_named(tmp_path):
    with BagWriter(tmp_path / "run.bag") as bag:
        stamps = write_frames(bag, toy_scan())
        write_poses(bag, toy_scan(), stamps, "pose")
        for stamp in stamps:
            bag.pose("/guess", stamp, "map", pose(9))
    write_masks(tmp_path, toy_scan(), stamps)
    with pytest.raises(DatasetError, match=r"/camera_pose, /guess may say where .*--topic\.pose"):
        load(tmp_path)
    assert_scans_equal(load(tmp_path, pose_topic="/camera_pose"), toy_scan(), 0)
    np.testing.assert_allclose(
        load(tmp_path, pose_topic="/guess").frames[0].T_world_camera, pose(9), atol=1e-9
    )


def test_a_frame_with_two_parents_or_a_circle_of_frames_is_named(tmp_path):
    for name, child, parent, message in (
        ("two", "base_link", "elsewhere", "frame base_link has several parents"),
        ("circle", "map", "base_link", "frames go round in a circle"),
    ):
        with BagWriter(tmp_path / name / "run.bag") as bag:
            stamps = write_frames(bag, toy_scan())
            write_poses(bag, toy_scan(), stamps, "tf")
            bag.tf("/tf", stamps[0], child, parent, np.eye(4))
        with pytest.raises(DatasetError, match=message):
            load(tmp_path / name)


def test_depth_of_another_camera_than_its_colour_is_refused(tmp_path):
    def write(bag):
        stamps = write_frames(bag, toy_scan())
        raw = "/camera/depth/image_rect_raw"
        for stamp, frame in zip(stamps, frames_of(toy_scan()), strict=True):
            bag.image(raw, stamp, "camera_depth_frame", "16UC1", millimetres(frame))
            bag.info("/camera/depth/camera_info", stamp, "camera_depth_frame", frame.intrinsics)
        return stamps

    bag_of(tmp_path, write)
    assert_scans_equal(load(tmp_path), toy_scan(), 0)  # depth that is registered comes first
    with pytest.raises(DatasetError, match=rf"{COLOR} is of frame {CAMERA}, its camera .*/depth/camera_info"):
        load(tmp_path, depth_topic="/camera/depth/image_rect_raw")
    alone = load(tmp_path, depth_topic="/camera/depth/image_rect_raw", color_topic="none")
    assert alone.frames[0].color is None
    np.testing.assert_array_equal(alone.frames[0].depth, toy_scan().frames[0].depth)


def test_a_distorted_lens_is_told(tmp_path, caplog):
    def write(bag):
        stamps = [START]
        bag.image(DEPTH, START, CAMERA, "16UC1", millimetres(toy_scan().frames[0]))
        bag.info(INFO, START, CAMERA, toy_scan().frames[0].intrinsics, distortion=0.1)
        return stamps * 3

    load(bag_of(tmp_path, write))
    assert f"the lens distortion of {INFO} is not corrected" in caplog.text


def test_stride_and_masks_choose_frames(tmp_path):
    write_recording(tmp_path, toy_scan())
    names = [name_of(START + k * STEP) for k in range(3)]
    assert load(tmp_path, stride=2).frames.names == (names[0], names[2])
    (tmp_path / "masks" / f"{names[0]}.png").unlink()
    assert load(tmp_path).frames.names == tuple(names[1:])
    with pytest.raises(DatasetError, match="stride 0"):
        load(tmp_path, stride=0)


def test_scenes_are_bags(tmp_path):
    write_recording(tmp_path / "a", toy_scan())
    write_recording(tmp_path / "b", toy_scan(), "mcap")
    assert scenes("bag", tmp_path) == ["a", "b"]
    assert len(load_scan("bag", tmp_path, "b").frames) == 3
    assert scenes("bag", tmp_path / "a") == ["run.bag"]
    (tmp_path / "a" / "run.bag").rename(tmp_path / "b" / "run.bag")
    with pytest.raises(DatasetError, match=r"several scenes: name one; available: run, run\.bag"):
        load(tmp_path / "b")
    with pytest.raises(DatasetError, match="holds no bag"):
        load(tmp_path / "a")
    with pytest.raises(DatasetError, match="absent: no such file"):
        load(tmp_path / "absent")


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (
            lambda bag, f: bag.image(DEPTH, START, CAMERA, "8UC1", np.zeros((48, 64), np.uint8)),
            "encoding 8UC1",
        ),
        (
            lambda bag, f: bag.image(DEPTH, START, CAMERA, "32FC1", np.zeros((48, 64), np.uint16)),
            "are no image of 64x48 pixels, 32FC1",
        ),
        (
            lambda bag, f: bag.compressed(DEPTH, START, CAMERA, "16UC1; RVL", bytes(40)),
            "'16UC1; RVL' is no PNG",
        ),
        (
            lambda bag, f: bag.compressed(DEPTH, START, CAMERA, "png", b"\x89PNG\r\n\x1a\n" + bytes(9)),
            "no readable image",
        ),
        (
            lambda bag, f: bag.image(DEPTH, START, CAMERA, "16UC1", np.ones((48, 30), np.uint16)),
            "other proportions",
        ),
    ],
)
def test_images_that_are_none_are_named_by_topic_and_frame(tmp_path, write, message):
    with BagWriter(tmp_path / "run.bag") as bag:
        write(bag, frames_of(toy_scan())[0])
        bag.info(INFO, START, CAMERA, toy_scan().frames[0].intrinsics)
        bag.pose("/pose", START, "map", pose(0))
    write_masks(tmp_path, toy_scan(1), [START])
    with pytest.raises(DatasetError, match=message) as caught:
        load(tmp_path).frames[0]
    assert str(tmp_path / "run.bag") in str(caught.value)


def test_images_without_time_are_no_frames(tmp_path):
    with BagWriter(tmp_path / "run.bag") as bag:
        for frame in frames_of(toy_scan()):
            bag.image(DEPTH, 0, CAMERA, "16UC1", millimetres(frame))
            bag.info(INFO, 0, CAMERA, frame.intrinsics)
    with pytest.raises(DatasetError, match="all 3 headers have the same time"):
        load(tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One bag of each kind."""
    found = {}
    for kind in KINDS:
        folder = tmp_path_factory.mktemp(kind)
        path = write_recording(folder, toy_scan(), kind)
        file = path if path.is_file() else path / f"run.{kind}"
        file.with_name("whole").write_bytes(file.read_bytes())
        found[kind] = (folder, file)
    return found


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(KINDS), st.floats(0, 1), st.booleans(), st.binary(min_size=1, max_size=8))
@example("bag", 0.0, True, b"")
@example("mcap", 0.5, True, b"")
@example("db3", 0.5, True, b"")
def test_a_damaged_bag_is_named_or_read(whole, kind, share, cut, junk):
    folder, file = whole[kind]
    data = file.with_name("whole").read_bytes()
    place = int(share * (len(data) - 1))
    file.write_bytes(data[:place] if cut else data[:place] + junk + data[place + len(junk) :])
    try:
        frames_of(load(folder))
    except DatasetError as error:
        named = str(error)
    else:
        named = str(folder)
    assert str(folder) in named


def test_without_rosbags_the_extra_is_named(tmp_path, monkeypatch):
    write_recording(tmp_path, toy_scan())
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DatasetError, match=r"pip install 'objgraph\[bag\]'"):
        load(tmp_path)


def test_the_command_takes_topics_and_its_record_keeps_them(tmp_path, capsys):
    write_recording(tmp_path / "robot", toy_scan())
    arguments = ["map", "--dataset", "bag", "--root", str(tmp_path / "robot"), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--topic.depth", "/nowhere"]) == 1
    assert "/nowhere, named as depth, has no messages" in capsys.readouterr().err
    few = ["--views", "1", "--min-pixels", "99999", "--topic.color", "none", "--topic.world", "odom"]
    assert main([*arguments, *few]) == 0
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    assert config["topic"] == {"depth": "", "color": "none", "info": "", "pose": "", "world": "odom"}
    again = ["map", "--config", str(tmp_path / "out" / "config.json"), "--out", str(tmp_path / "again")]
    assert main([*again, "--topic.pose", "/tf"]) == 0
    config = json.loads((tmp_path / "again" / "config.json").read_text())
    assert config["topic"] == {"depth": "", "color": "none", "info": "", "pose": "/tf", "world": "odom"}
    assert main(["map", "--dataset", "sample", "--root", "x", "--topic.pose", "/tf", "--out", "y"]) == 1
    assert "has no option pose_topic" in capsys.readouterr().err


def test_a_bag_without_masks_is_segmented(tmp_path, monkeypatch, caplog):
    def by_depth(self, color):
        mask = np.zeros(color.shape[:2], bool)
        mask[10:30, 20:40] = True
        return [Segment("chair", 0.9, mask)]

    monkeypatch.setattr(Segmenter, "load", classmethod(lambda cls, weights, device: Segmenter(Network())))
    monkeypatch.setattr(Segmenter, "segment", by_depth)
    scan = toy_scan()
    still = [replace(frame, T_world_camera=pose(0)) for frame in frames_of(scan)]
    with BagWriter(tmp_path / "run.bag") as bag:
        stamps = write_frames(bag, scan)
        for stamp, frame in zip(stamps, still, strict=True):
            bag.pose("/camera_pose", stamp, "map", frame.T_world_camera)
    with caplog.at_level(logging.WARNING):
        assert main(["segment", "--dataset", "bag", "--root", str(tmp_path), "--stride", "2"]) == 0
    read = load(tmp_path)
    assert read.frames.names == (name_of(stamps[0]), name_of(stamps[2]))
    assert [each.category for each in read.instances] == ["chair"]
    np.testing.assert_array_equal(read.up_world, [0, 0, 1])
    assert set(np.unique(read.frames[0].instances)) == {0, 1}
