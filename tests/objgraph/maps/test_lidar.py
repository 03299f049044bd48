"""Cars from single scans: every one has a result or a reason, near the truth, and covariances behave as physics says."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from objgraph.cli.main import main
from objgraph.datasets.kitti import load_frame, load_labels
from objgraph.errors import ConfigError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate
from objgraph.geometry.boxes import OrientedBox, box_iou
from objgraph.maps.lidar import LidarMappingConfig, map_lidar
from objgraph.maps.lidar_task import ROADS, LidarTaskConfig, task_of
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.lidar.observe import LidarSamplingConfig
from objgraph.priors.registry import prior_for
from objgraph.synthetic.street import StreetConfig, ensure_street


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"), StreetConfig(frames=1))


@pytest.fixture(scope="module")
def frame(street):
    return load_frame(street)


@pytest.fixture(scope="module")
def mapped(frame) -> ObjectMap:
    behind = replace(frame.detections[0], id=9, T_world_object=np.diag([1.0, 1.0, 1.0, 1.0]))
    behind.T_world_object[2, 3] = -10.0
    return map_lidar(replace(frame, detections=(*frame.detections, behind)))


def test_every_detection_has_a_result_or_a_reason(frame, mapped):
    assert [entry.id for entry in mapped.objects] == [*(each.id for each in frame.detections), 9]
    failed = mapped.objects[-1]
    assert failed.status == "failed"
    assert "not ahead of the LiDAR" in str(failed.reason)
    assert len(mapped.mapped) == len(frame.detections)


def test_two_processes_make_the_same_map(frame, mapped):
    again = map_lidar(frame, jobs=2)
    for ours, theirs in zip(mapped.objects, again.objects, strict=False):
        np.testing.assert_array_equal(ours.joint_covariance, theirs.joint_covariance)
    with pytest.raises(ConfigError, match="jobs"):
        map_lidar(frame, jobs=0)


def test_estimates_are_near_the_truth(street, frame, mapped):
    labels = load_labels(street, frame.name)
    better = []
    for detection, entry in zip(frame.detections, mapped.mapped, strict=True):
        label = min(labels, key=lambda each: np.linalg.norm(each.box.centre - detection.box.centre))
        box = OrientedBox.about(np.asarray(entry.vertices), entry.state.T_world_object.rotation().matrix())
        better.append(box_iou(box, label.box) - box_iou(detection.box, label.box))
        assert box_iou(box, label.box) > 0.8
    assert np.mean(better) > 0.15


def test_the_map_can_be_saved_with_its_covariances(mapped, tmp_path):
    mapped.save(tmp_path)
    loaded = ObjectMap.load(tmp_path).objects[0]
    assert loaded.uncertainty.matrix.shape == mapped.objects[0].uncertainty.matrix.shape
    assert loaded.estimator == "graph"


def car_from_behind(frame):
    """The one straight ahead: its back alone is seen."""
    return min(frame.detections, key=lambda each: abs(each.T_world_object[0, 3]))


def sigmas(frame, points: int) -> np.ndarray:
    """Standard deviations of the middle: right, up and back in the car's own axes."""
    sampling = LidarSamplingConfig(points=points, free=points // 2)
    task = task_of(frame, car_from_behind(frame), prior_for("car"), LidarTaskConfig(sampling))
    (estimate,) = GraphEstimator(ROADS).estimate([task])
    assert isinstance(estimate, Estimate)
    assert estimate.covariance is not None
    return estimate.covariance.block("translation").sigma


def test_covariances_behave_as_physics_says(frame):
    """A car seen from behind is known less along than across, and the better the more returns there are."""
    few, many = sigmas(frame, 20), sigmas(frame, 200)
    for right, _, back in (few, many):
        assert back > right
    assert (many[[0, 2]] < few[[0, 2]]).all()


def test_nothing_detected_is_an_empty_map(frame):
    assert map_lidar(replace(frame, detections=())).objects == ()


def test_one_of_a_category_without_a_prior_is_mapped_with_the_stand_in(frame, caplog):
    truck = replace(frame.detections[0], category="truck")
    entry = map_lidar(replace(frame, detections=(truck,)), LidarMappingConfig(mesh_resolution=32)).objects[0]
    assert entry.status == "mapped"
    assert entry.prior is not None
    assert entry.prior.fallback


def test_settings_of_a_lidar_are_its_own_and_those_of_a_camera_are_refused(tmp_path, capsys):
    street = ensure_street(tmp_path, StreetConfig(frames=1, cars=2))
    out, file = tmp_path / "out", tmp_path / "settings.json"
    arguments = ["map", "--dataset", "kitti", "--root", str(street), "--out", str(out)]
    task = {"detector": {"position": 0.2}, "sampling": {"free": 40, "points": 250}}
    file.write_text(json.dumps({"settings": {"task": task, "graph": {"floor_sigma": 0.1}, "seed": 1}}))
    given = ["--config", str(file), "--seed", "3", "--mesh-resolution", "32"]
    assert main([*arguments, *given]) == 0
    document = json.loads((out / "config.json").read_text())
    used = document["settings"]
    assert used["task"]["detector"]["position"] == 0.2
    assert (used["task"]["sampling"]["free"], used["task"]["sampling"]["points"]) == (40, 250)
    assert (used["graph"]["floor_sigma"], used["seed"]) == (0.1, 3)
    assert used["graph"]["tight_box"]  # what was not given is as it is for roads
    assert (document["dataset"], document["root"], document["scene"]) == ("kitti", str(street), "000000")
    said = capsys.readouterr().out
    assert re.search(r"^mapped car \d: 2 of 2, \d+\.\d s$", said, flags=re.MULTILINE)
    assert "2 of 2 objects mapped" in said
    assert (out / "map.png").stat().st_size > 10_000
    again = tmp_path / "again"
    assert main(["map", "--config", str(out / "config.json"), "--out", str(again)]) == 0
    assert json.loads((again / "config.json").read_text()) == document
    for one, two in zip(ObjectMap.load(out).objects, ObjectMap.load(again).objects, strict=True):
        np.testing.assert_array_equal(one.T_world_object, two.T_world_object)
    capsys.readouterr()
    refused = [
        (["--views", "2"], "data set 'kitti' does not use --views"),
        (["--estimator", "adam"], "data set 'kitti' does not use --estimator"),
        (["--scan2cad", "."], "data set 'kitti' does not use --scan2cad"),
    ]
    for option, message in refused:
        assert main([*arguments, *option]) == 1
        assert message in capsys.readouterr().err
    file.write_text(json.dumps({"settings": {"sampling": {"flying": 0.1}}}))
    assert main([*arguments, "--config", str(file)]) == 1
    assert "settings.json: settings: no setting sampling of data set 'kitti'" in capsys.readouterr().err
