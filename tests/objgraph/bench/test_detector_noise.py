"""Detections with scaled noise: nothing changes, the labels come out, and errors are multiples."""

import json

import numpy as np
import pytest

from objgraph.bench.comparison.boxes.compare import LidarComparison, compare_boxes
from objgraph.bench.comparison.boxes.detector_noise import scaled
from objgraph.bench.comparison.boxes.matching import LabelledBox, heading_between_deg, matches
from objgraph.bench.comparison.boxes.report import box_report
from objgraph.cli.main import main
from objgraph.datasets.kitti import CATEGORIES, load_frame, load_labels
from objgraph.errors import EvaluationError
from objgraph.observation.lidar.frame import Detection
from objgraph.synthetic.street import StreetConfig, ensure_street


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"), StreetConfig(frames=2, cars=2))


def matched_of(root, name):
    frame = load_frame(root, name)
    labels = [
        LabelledBox(i, CATEGORIES[box.type], box.T_rect_object, box.size)
        for i, box in enumerate(load_labels(root, name), 1)
    ]
    return frame.detections, matches(frame.detections, labels)


def errors(each: Detection, label: LabelledBox):
    T, true = each.T_world_object, label.T_world_object
    return T[:3, 3] - true[:3, 3], heading_between_deg(T, true), np.log(each.size / label.size)


def test_one_leaves_the_detections_and_nought_gives_the_labels(street):
    detections, matched = matched_of(street, "000000")
    assert len(matched) == len(detections) == 2
    assert all(a is b for a, b in zip(scaled(detections, matched, 1.0), detections, strict=True))
    for each in scaled(detections, matched, 0.0):
        label = matched[each.id]
        np.testing.assert_array_equal(each.T_world_object, label.T_world_object)
        np.testing.assert_array_equal(each.size, label.size)


@pytest.mark.parametrize("factor", [0.5, 2.0, 1.0 + 1e-12])
def test_errors_are_multiples(street, factor):
    detections, matched = matched_of(street, "000001")
    for before, after in zip(detections, scaled(detections, matched, factor), strict=True):
        assert (after.id, after.category, after.score) == (before.id, before.category, before.score)
        for a, b in zip(errors(after, matched[before.id]), errors(before, matched[before.id]), strict=True):
            np.testing.assert_allclose(a, factor * np.asarray(b), atol=1e-6)
        R = after.T_world_object[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)


def test_headings_are_wrapped():
    """Two degrees about the half turn are no 358."""

    def turned(degrees: float) -> np.ndarray:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        T = np.eye(4)
        T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        return T

    label = LabelledBox(1, "car", turned(179), np.ones(3))
    (after,) = scaled([Detection(1, "car", turned(-179), np.ones(3))], {1: label}, 2.0)
    np.testing.assert_allclose(after.T_world_object, turned(183), atol=1e-9)


def test_what_has_no_label_stays(street):
    detections, matched = matched_of(street, "000000")
    first, second = scaled(detections, {detections[0].id: matched[detections[0].id]}, 0.0)
    assert first is not detections[0]
    assert second is detections[1]


def test_the_same_objects_are_compared_and_the_factor_is_told(street, tmp_path):
    once = compare_boxes(LidarComparison(street, (), tmp_path / "1"))
    comparison = LidarComparison(street, (), tmp_path / "4", detector_noise=4.0)
    rows = compare_boxes(comparison)
    assert [(row.key, row.label, row.points) for row in rows] == [
        (row.key, row.label, row.points) for row in once
    ]
    for row, other in zip(rows, once, strict=True):
        assert row.error_m is not None
        assert other.error_m is not None
        np.testing.assert_allclose(row.error_m, 4 * np.array(other.error_m), atol=1e-9)
    # beyond the filter of matching, and still of the same label
    assert max(np.linalg.norm(row.error_m or 0.0) for row in rows) > comparison.match.distance
    report = box_report(comparison, rows, 0)
    assert report.tables[0].title == "Table III: boxes of single scans, 4 times the detections' noise"
    assert report.details["settings"]["detections"]["detector_noise"] == 4.0
    with pytest.raises(EvaluationError, match=r"detector_noise: 4\.0 before, 0\.5 now"):
        compare_boxes(LidarComparison(street, (), tmp_path / "4", detector_noise=0.5))


def test_the_command_takes_a_factor(street, tmp_path, capsys):
    arguments = [
        "evaluate",
        "--dataset",
        "kitti",
        "--root",
        str(street),
        "--methods",
        "graph",
        "--scenes",
        "000000",
    ]
    assert main([*arguments, "--out", str(tmp_path), "--detector-noise", "0"]) == 0
    rows = {row["method"]: row for row in json.loads((tmp_path / "figures.json").read_text())["rows"]}
    assert rows["detections"]["mean_iou"] == pytest.approx(1.0, abs=1e-6)
    assert rows["graph"]["mean_iou"] > 0.8
    capsys.readouterr()
    assert main([*arguments, "--out", str(tmp_path / "b"), "--detector-noise", "-1"]) == 1
    assert "--detector-noise takes a number from 0 on" in capsys.readouterr().err
