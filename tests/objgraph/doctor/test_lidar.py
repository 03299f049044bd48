"""LiDAR scans in KITTI's layout: what was understood, and what is wrong."""

import json
import shutil
import weakref

import numpy as np
import pytest

from objgraph.datasets.kitti import frames
from objgraph.doctor import examine_lidar, lidar
from objgraph.synthetic.street import ensure_street


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"))


@pytest.fixture
def root(street, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(street, tmp_path / "kitti")


def wrong(sections):
    return [finding for section in sections for finding in section.wrong]


def test_nothing_is_wrong_with_the_street(street):
    sections = examine_lidar("kitti", street)
    assert not [finding for section in sections for finding in section.findings]
    names = frames(street)
    assert dict(sections[0].rows)["frames"] == f"{len(names)} of {len(names)} can be read"
    assert "car" in dict(sections[1].rows)


def test_nothing_is_wrong_with_the_real_frames(shared_data):
    sections = examine_lidar("kitti", shared_data / "kitti")
    assert not wrong(sections)
    assert dict(sections[1].rows)["car"] == "22 detected"


def test_no_scan_is_kept(street, monkeypatch):
    """KITTI has thousands, some megabytes each: what is read is let go before the next but one."""
    load, frames_read, alive = lidar.load_lidar_frame, [], []

    def counted(dataset, root, name):
        alive.append(sum(each() is not None for each in frames_read))
        frame = load(dataset, root, "000000")
        frames_read.append(weakref.ref(frame))
        return frame

    monkeypatch.setattr(lidar, "load_lidar_frame", counted)
    monkeypatch.setattr(lidar, "lidar_frames", lambda dataset, root: ["000000"] * 4)
    examine_lidar("kitti", street)
    assert len(alive) == 4
    assert max(alive) <= 1


def test_a_damaged_frame_is_named_and_the_others_are_read(root):
    first, *others = frames(root)
    (root / "training" / "velodyne" / f"{first}.bin").write_bytes(b"123")
    sections = examine_lidar("kitti", root)
    (finding,) = wrong(sections)
    assert finding.where == f"frame {first}"
    assert f"{first}.bin: 3 bytes are no whole number of returns" in finding.what
    assert dict(sections[0].rows)["frames"] == f"{len(others)} of {len(others) + 1} can be read"


def test_boxes_that_hold_nothing(root):
    """As if the calibration were another car's: the LiDAR looks to the side."""
    for path in (root / "training" / "calib").iterdir():
        lines = path.read_text().splitlines()
        turned = "Tr_velo_to_cam: 1 0 0 0 0 0 -1 0 0 1 0 0"
        path.write_text("\n".join(turned if line.startswith("Tr_velo") else line for line in lines))
    (finding,) = wrong(examine_lidar("kitti", root))
    assert "boxes hold less than 5 returns of the LiDAR" in finding.what
    assert "boxes and calibration belong to these scans" in finding.do


def test_no_detection_at_all(root):
    for path in (root / "detections").iterdir():
        path.write_text("")
    (finding,) = wrong(examine_lidar("kitti", root))
    assert finding.what == "nothing is detected that could be mapped"


def test_no_scans(root, tmp_path):
    (finding,) = wrong(examine_lidar("kitti", tmp_path / "absent"))
    assert "no such folder" in finding.what
    for path in (root / "training" / "velodyne").iterdir():
        path.unlink()
    (finding,) = wrong(examine_lidar("kitti", root))
    assert "there is no scan" in finding.what


def test_a_lidar_of_ones_own_is_read(tmp_path):
    box = {"category": "car", "centre": [8.0, 0.0, 0.0], "size": [4.0, 2.0, 1.5], "yaw": 0.0}
    p_lidar = np.random.default_rng(0).uniform([6, -1, -0.7], [10, 1, 0.7], (50, 3))
    returns = np.c_[p_lidar, np.ones(50)].astype(np.float32)
    returns.tofile(tmp_path / "points.bin")
    (tmp_path / "detections.json").write_text(json.dumps({"boxes": [box]}))
    assert not wrong(examine_lidar("lidar", tmp_path))
    (tmp_path / "detections.json").write_text(json.dumps({"boxes": [{**box, "centre": [30, 0, 0]}]}))
    (finding,) = wrong(examine_lidar("lidar", tmp_path))
    assert "boxes hold less than 5 returns" in finding.what
