"""KITTI's layout: frames of reference, what is left out, and what is missing or damaged."""

import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from objgraph.cli.main import main
from objgraph.datasets.kitti import frames, load_frame, load_labels
from objgraph.datasets.kitti_files import read_boxes, read_calibration, read_velodyne
from objgraph.errors import DatasetError
from objgraph.synthetic.street import ensure_street


@pytest.fixture(scope="session")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"))


@pytest.fixture
def root(street, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(street, tmp_path / "kitti")


def test_returns_lie_in_the_labelled_boxes(street):
    """Points go through the calibration and boxes through their own convention: both must meet."""
    for name in frames(street):
        frame = load_frame(street, name)
        for label in load_labels(street, name):
            grown = label.box
            inside = grown.contains(frame.p_world)
            assert inside.sum() > 50
            # along the car's own axes: width, height, length are not mistaken for each other
            in_box = (frame.p_world[inside] - grown.centre) @ grown.rotation
            assert (np.abs(in_box).max(axis=0) <= label.size / 2 + 1e-9).all()
            assert np.ptp(in_box[:, 1]) > 0.8 * label.size[1]


def test_axes_are_those_of_the_priors(street):
    label = load_labels(street, "000000")[0]
    R = label.box.rotation
    assert np.allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0
    assert np.allclose(R[:, 1], [0, -1, 0])  # up is against the camera's y
    ahead = np.array([np.cos(label.yaw), 0, -np.sin(label.yaw)])  # KITTI's heading
    assert np.allclose(-R[:, 2], ahead)
    assert np.allclose(label.box.centre - label.bottom, [0, -label.height / 2, 0])


def test_the_picture_shows_the_returns(street):
    frame = load_frame(street, "000000")
    assert frame.picture is not None
    ids = frame.picture.ids_at(frame.p_world)
    assert (ids == -1).all()  # nobody segmented it
    K, T = frame.picture.intrinsics, frame.picture.T_world_camera
    for label in load_labels(street, "000000"):
        body = replace(label.box, extents=label.size * [1.0, 0.5, 1.0])  # without the road between the wheels
        p_camera = frame.p_world[body.contains(frame.p_world)] - T[:3, 3]
        u, v = K.project(p_camera).T
        left, top, right, bottom = label.image_box
        # cut at the picture's edge
        u, v = u.clip(0, K.width - 1), v.clip(0, K.height - 1)
        assert (u > left - 3).all()
        assert (u < right + 3).all()
        assert (v > top - 3).all()
        assert (v < bottom + 3).all()


def test_a_detection_has_a_detectors_errors_in_the_picture_too(street):
    """Its picture box holds its own box in space, cut at the picture's edge, and is no label's."""
    frame = load_frame(street, "000000")
    assert frame.picture is not None
    K, T = frame.picture.intrinsics, frame.picture.T_world_camera
    labels = [label.image_box for label in load_labels(street, "000000")]
    detections = read_boxes(street / "detections" / "000000.txt")
    assert detections
    for found in detections:
        assert all(np.abs(found.image_box - label).max() > 0.5 for label in labels)
        corners = found.size * (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
        R, t = found.T_rect_object[:3, :3], found.T_rect_object[:3, 3]
        u, v = K.project(corners @ R.T + t - T[:3, 3]).T
        u, v = u.clip(0, K.width - 1), v.clip(0, K.height - 1)
        np.testing.assert_allclose(found.image_box, [u.min(), v.min(), u.max(), v.max()], atol=0.5)


def test_masks_name_detections(root):
    frame = load_frame(root, "000000")
    assert frame.picture is not None
    mask = np.zeros(frame.picture.color.shape[:2], np.uint8)
    mask[:, 600:] = 2
    (root / "masks").mkdir()
    cv2.imwrite(str(root / "masks" / "000000.png"), mask)
    frame = load_frame(root, "000000")
    assert frame.picture is not None
    assert set(frame.picture.ids_at(frame.p_world)) == {-1, 0, 2}
    assert (frame.picture.ids_at(np.array([[0.0, 0.0, -5.0]])) == -1).all()  # behind the camera


def test_what_no_prior_is_for_is_left_out(root):
    path = root / "detections" / "000000.txt"
    first, *rest = path.read_text().splitlines()
    dont_care = "DontCare -1 -1 -10 800.38 163.67 825.45 184.07 -1 -1 -1 -1000 -1000 -1000 -10"
    path.write_text("\n".join([dont_care, first.replace("Car", "Pedestrian"), *rest]))
    before = 1 + len(rest)
    found = load_frame(root, "000000").detections
    assert len(found) == before - 1
    assert all(each.category == "car" for each in found)
    assert len(read_boxes(path)) == before  # the pedestrian has a box, what nobody cares for has none
    path.write_text("")
    assert load_frame(root, "000000").detections == ()


def test_what_is_not_mapped_is_known(root):
    """A pedestrian beside a car keeps its returns; one in the car's box is the car, taken for another."""
    path = root / "detections" / "000000.txt"
    before = load_frame(root, "000000")
    assert before.others == ()
    line = path.read_text().splitlines()[0].split()
    height, width, length, x, y, z = map(float, line[8:14])
    beside = ["Pedestrian", *line[1:8], "1.8", "0.5", "0.5", str(x + length), str(y), str(z), *line[14:]]
    within = ["Van", *line[1:8], str(height), str(width), str(length), str(x), str(y), str(z), *line[14:]]
    path.write_text("\n".join([" ".join(beside), " ".join(within), path.read_text()]))
    after = load_frame(root, "000000")
    assert [(each.id, each.category) for each in after.others] == [(1, "Pedestrian")]
    np.testing.assert_allclose(after.others[0].T_world_object[:3, 3], [x + length, y - 0.9, z])
    assert [each.id - 2 for each in after.detections] == [each.id for each in before.detections]


def test_a_picture_may_be_missing(root):
    (root / "training" / "image_2" / "000000.png").unlink()
    assert load_frame(root, "000000").picture is None


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("training/calib/000000.txt", None, "000000.txt: cannot be read"),
        ("training/calib/000000.txt", "P2: 1 2 3\n", "P2 is no 3x4 matrix"),
        ("training/calib/000000.txt", "R0_rect: 1\n", "has no P2"),
        ("training/velodyne/000000.bin", b"", "the scan is empty"),
        ("training/velodyne/000000.bin", b"12345", "no whole number of returns"),
        ("detections/000000.txt", None, "000000.txt: cannot be read"),
        ("detections/000000.txt", "Car 1 2 3\n", "line 1: 4 columns"),
        ("detections/000000.txt", "Car" + " x" * 15, "line 1: could not convert"),
        ("detections/000000.txt", "Car" + " 0" * 15, "is no box; delete the line"),
        ("detections/000000.txt", "Car 0 nan" + " 1" * 13, "line 1: column 3 is nan, no number"),
        ("detections/000000.txt", "DontCare 0 inf" + " 1" * 13, "line 1: column 3 is inf, no number"),
        ("training/velodyne/000000.bin", np.full(8, np.nan, "<f4").tobytes(), "no return is finite"),
        ("training/image_2/000000.png", b"no png", "no readable image"),
    ],
)
def test_what_is_missing_or_damaged_is_named(root, file, content, message):
    path = root / file
    path.unlink()
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DatasetError, match=message):
        load_frame(root, "000000")


def test_a_calibration_that_is_no_motion_is_refused(root):
    path = root / "training" / "calib" / "000000.txt"
    text = path.read_text().replace("R0_rect: 1.0", "R0_rect: 3.0")
    path.write_text(text)
    with pytest.raises(DatasetError, match="no rigid motion"):
        read_calibration(path)
    path.write_text(re.sub(r"R0_rect: \S+", "R0_rect: nan", text))
    with pytest.raises(DatasetError, match="R0_rect has numbers that are not finite"):
        read_calibration(path)
    path.write_text(text.replace("P2: 7.2", "P2: -7.2"))
    with pytest.raises(DatasetError, match="no camera's matrix"):
        read_calibration(path)


@pytest.mark.parametrize("colon", ["", ":", " : "])
def test_a_calibration_of_the_tracking_benchmark_is_read(root, colon):
    """It has other names, and no colon behind them."""
    path = root / "training" / "calib" / "000000.txt"
    before = read_calibration(path)
    text = path.read_text().replace("R0_rect:", f"R_rect{colon}")
    path.write_text(text.replace("Tr_velo_to_cam:", f"Tr_velo_cam{colon}"))
    after = read_calibration(path)
    np.testing.assert_array_equal(after.T_rect_velodyne, before.T_rect_velodyne)
    np.testing.assert_array_equal(after.K, before.K)


def test_files_of_a_windows_editor_are_read(root):
    """Their mark of Unicode is no part of the first detection's type, which would be left out without a word."""
    before = load_frame(root, "000000")
    for path in (root / "detections" / "000000.txt", root / "training" / "calib" / "000000.txt"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_text().replace("\n", "\r\n").encode())
    after = load_frame(root, "000000")
    assert [each.id for each in after.detections] == [each.id for each in before.detections]
    np.testing.assert_array_equal(after.T_world_lidar, before.T_world_lidar)


def test_returns_that_are_not_finite_are_left_out(tmp_path):
    points = np.ones((3, 4), np.float32)
    points[1, 2] = np.nan
    (tmp_path / "scan.bin").write_bytes(points.tobytes())
    assert read_velodyne(tmp_path / "scan.bin").shape == (2, 3)


def test_frames_are_named(root):
    assert frames(root) == ["000000", "000001"]
    with pytest.raises(DatasetError, match="no scene '7'; available: 000000, 000001"):
        load_frame(root, "7")
    with pytest.raises(DatasetError, match="several scenes: name one"):
        load_frame(root)
    with pytest.raises(DatasetError, match="no such folder"):
        frames(root / "training")


def test_the_command_line_says_what_is_wrong(root, tmp_path, capsys):
    for arguments, message in [
        (["--root", str(root)], "several scenes"),
        ([], "--root must name its folder"),
        (["--root", str(root), "--scene", "000000", "--categories", "chair"], "nothing is detected"),
        (["--root", str(root), "--scene", "000000", "--estimator", "adam"], "does not use --estimator"),
    ]:
        out = ["--out", str(tmp_path / "out")]
        assert main(["map", "--dataset", "kitti", *out, *arguments]) == 1
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_real_frames(shared_data):
    root = shared_data / "kitti"
    assert len(frames(root)) == 10
    assert sum(len(load_frame(root, name).detections) for name in frames(root)) == 22
    counts = [
        label.box.contains(load_frame(root, name).p_world).sum()
        for name in ("000008", "000142")
        for label in load_labels(root, name)
        if label.type == "Car"
    ]
    assert max(counts) > 1000
