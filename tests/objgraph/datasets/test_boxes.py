"""Scans with object boxes: true boxes apart from the scan, in the object's own axes; and ICL's layout."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from objgraph.datasets import load_scan, scenes
from objgraph.datasets.boxes import read_object_boxes, true_boxes
from objgraph.datasets.ground_truth import AnnotatedScan
from objgraph.datasets.registry import has_boxes, load_annotated
from objgraph.errors import DatasetError
from objgraph.metrics.placed import PlacedMesh
from tests.objgraph.datasets.dataset_folders import (
    camera_matrix,
    color_image,
    depth_image,
    jpeg,
    png,
    pose,
    write_bytes,
    write_matrix,
    write_seven_scenes,
)

SIDEWAYS, FACING, UP = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix().T
BOX = {
    "id": 4,
    "label": "chair",
    "centre": [0.5, -1.0, 2.0],
    "rotation": np.column_stack([SIDEWAYS, FACING, UP]).round(6).tolist(),
    "size": [0.4, 0.5, 0.9],
    "quality": "partial",
}


def write_objects(path: Path, *objects: dict) -> Path:
    write_bytes(path, json.dumps({"up": UP.tolist(), "objects": objects}).encode())
    return path


def write_icl(folder: Path) -> Path:
    """The same picture and box as `write_seven_scenes`."""
    for k in range(3):
        write_bytes(folder / "image" / f"{k:05d}.jpg", jpeg(color_image(k)))
        write_bytes(folder / "depth" / f"{k:05d}.png", png(depth_image(k)))
        write_matrix(folder / "pose" / f"{k:05d}.txt", pose(0))
    write_matrix(folder / "intrinsics.txt", camera_matrix()[:3, :3])
    box = {"id": 0, "label": "chair", "centre": [0, 0, 2.5], "rotation": np.eye(3).tolist(), "size": [4, 4, 0.2]}  # fmt: skip
    write_bytes(folder / "instances.json", json.dumps({"up": [0, 0, -2.0], "objects": [box]}).encode())
    return folder


def test_a_true_box_is_in_the_object_s_axes(tmp_path):
    (truth,) = true_boxes(write_objects(tmp_path / "instances.json", BOX)).values()
    R = truth.T_world_object[:3, :3]
    np.testing.assert_allclose(R[:, 1], UP, atol=1e-5)
    np.testing.assert_allclose(-R[:, 2], FACING, atol=1e-5)  # its front is at -z
    np.testing.assert_allclose(R[:, 0], SIDEWAYS, atol=1e-5)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert truth.quality == "partial"
    assert truth.symmetry == 1
    box = PlacedMesh.of_truth(truth).box
    np.testing.assert_allclose(box.extents, [0.4, 0.9, 0.5])  # sideways, up, facing
    np.testing.assert_allclose(box.centre, BOX["centre"])


def test_tables_are_the_same_from_both_sides_and_quality_may_be_left_out(tmp_path):
    table = {name: value for name, value in BOX.items() if name != "quality"} | {"label": "table"}
    (truth,) = true_boxes(write_objects(tmp_path / "instances.json", table)).values()
    assert truth.symmetry == 2
    assert truth.quality == "full"


@pytest.mark.parametrize("categories", [None, {"chair": "chair"}])
@pytest.mark.parametrize("label", [None, 3, ["chair"]])
def test_a_label_that_is_no_text_is_refused(tmp_path, label, categories):
    path = write_objects(tmp_path / "instances.json", BOX, {**BOX, "label": label})
    with pytest.raises(DatasetError, match="a label is no text"):
        read_object_boxes(path, categories)


def test_a_box_that_is_mirrored_is_no_truth(tmp_path):
    mirrored = BOX | {"rotation": np.diag([1.0, 1.0, -1.0]).tolist()}
    with pytest.raises(
        DatasetError, match="object 5: its box has no usable pose: its rotation is a reflection"
    ):
        true_boxes(write_objects(tmp_path / "instances.json", mirrored))


def test_only_the_evaluation_is_given_true_boxes(tmp_path):
    write_seven_scenes(tmp_path)
    assert not isinstance(load_scan("sevenscenes", tmp_path, "office"), AnnotatedScan)
    truths = load_annotated("sevenscenes", tmp_path, "office").ground_truth
    assert set(truths) == {1, 2}
    assert has_boxes("sevenscenes")
    assert has_boxes("icl")
    assert not has_boxes("scannet")


def test_icl_is_read_as_7_scenes_is(tmp_path):
    folder, office = write_icl(tmp_path / "icl" / "room"), write_seven_scenes(tmp_path / "seven")
    content = json.loads((office / "instances.json").read_text())
    write_bytes(office / "instances.json", json.dumps(content | {"objects": content["objects"][:1]}).encode())
    for root, scene in ((folder.parent, "room"), (folder, "room")):
        assert scenes("icl", root) == [scene]
        scan = load_annotated("icl", root, scene)
        assert set(scan.ground_truth) == {1}
    other = load_scan("sevenscenes", office.parent)
    assert (scan.name, scan.instances) == ("room", other.instances)
    np.testing.assert_array_equal(scan.up_world, other.up_world)
    assert len(scan.frames) == len(other.frames)
    for i in range(len(scan.frames)):
        mine, theirs = scan.frames[i], other.frames[i]
        np.testing.assert_array_equal(mine.depth, theirs.depth)
        np.testing.assert_array_equal(mine.instances, np.where(theirs.depth > 0, theirs.instances, 0))
        assert mine.color is not None
        assert theirs.color is not None
        np.testing.assert_array_equal(mine.color, theirs.color)
    assert np.count_nonzero(scan.frames[0].instances) > 100
    assert len(load_scan("icl", folder, stride=2).frames) == 2
    with pytest.raises(DatasetError, match="stride 0"):
        load_scan("icl", folder, stride=0)
    with pytest.raises(DatasetError, match="holds depth, and this one holds none"):
        load_scan("icl", office)
    for k, name in ((0, "9"), (1, "10")):  # numbers, not text
        for path in folder.glob(f"*/{k:05d}.*"):
            path.rename(path.with_stem(name))
    assert load_scan("icl", folder).frames.names == ("9", "10", "00002")


def test_the_real_armchair(shared_data):
    scan = load_annotated("icl", shared_data / "icl_livingroom1", "icl_livingroom1")
    assert len(scan.frames) == 43
    assert [instance.category for instance in scan.instances] == ["chair"]
    T = scan.ground_truth[1].T_world_object
    assert T[:3, 1] @ scan.up_world == pytest.approx(1.0, abs=1e-4)
    # it faces the camera that goes around it
    assert -T[:3, 2] @ (scan.frames[0].T_world_camera[:3, 3] - T[:3, 3]) > 0
    assert np.count_nonzero(scan.frames[0].instances) > 5000
