"""7-Scenes: frames, gravity, and masks cut out of the depth by boxes."""

import json
import logging

import numpy as np
import pytest

from objgraph.datasets import load_scan, scenes
from objgraph.datasets.ground_truth import AnnotatedScan, annotated
from objgraph.datasets.registry import load_annotated
from objgraph.errors import DatasetError
from objgraph.observation.frames import Instance
from tests.objgraph.datasets.dataset_folders import (
    HEIGHT,
    WIDTH,
    camera_matrix,
    pose,
    write_bytes,
    write_matrix,
    write_seven_scenes,
)


def _edit(folder, change):
    path = folder / "instances.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_points_in_a_box_are_the_objects(tmp_path, caplog):
    write_seven_scenes(tmp_path)
    everything = load_scan("sevenscenes", tmp_path)
    assert everything.instances == (Instance(1, "chair"), Instance(2, "plant"))
    with caplog.at_level(logging.INFO):
        scan = load_scan("sevenscenes", tmp_path, categories={"chair": "chair"})
    assert scan.instances == (Instance(1, "chair"),)
    assert "plant" in caplog.text
    assert not isinstance(scan, AnnotatedScan)
    assert len(annotated(scan).ground_truth) == 0
    np.testing.assert_allclose(scan.up_world, [0, 0, -1])
    frame = scan.frames[1]
    assert frame.name == "frame-000001"
    expected = np.zeros((HEIGHT, WIDTH), dtype=int)
    expected[10:30, 20:40] = 1
    np.testing.assert_array_equal(frame.instances, expected)
    assert frame.depth[0, 0] == 0
    assert frame.depth[0, 1] == 0
    assert frame.color is not None
    np.testing.assert_allclose(frame.color[5, 5], [201, 40, 20], atol=4)


def test_a_sequences_own_folder_is_a_root(tmp_path):
    folder = write_seven_scenes(tmp_path)
    assert scenes("sevenscenes", folder) == scenes("sevenscenes", tmp_path) == [folder.name]
    own, above = (load_annotated("sevenscenes", root, folder.name) for root in (folder, tmp_path))
    assert own.name == above.name
    assert own.frames.names == above.frames.names
    assert own.ground_truth.keys() == above.ground_truth.keys() == {1, 2}
    (folder / "camera-intrinsics.txt").unlink()
    with pytest.raises(DatasetError, match=r"a scan's folder holds camera-intrinsics\.txt"):
        load_scan("sevenscenes", folder)


def test_the_floor_belongs_to_no_object(tmp_path):
    folder = write_seven_scenes(tmp_path)
    # world z points down here and the floor lies at z = 2.5, just under the object
    _edit(folder, lambda c: c.update(floor_d=2.52))
    assert load_scan("sevenscenes", tmp_path).frames[0].instances.max() == 0
    assert load_scan("sevenscenes", tmp_path, floor_margin=0.01).frames[0].instances.max() == 1


def test_a_hand_placed_box_may_be_a_centimetre_off(tmp_path):
    folder = write_seven_scenes(tmp_path)
    # the object lies at z = 2.5, one or four centimetres outside a box that is 0.2 m deep
    for distance, owner in ((0.01, 1), (0.04, 0)):
        _edit(folder, lambda c, d=distance: c["objects"][0].update(centre=[0, 0, 2.6 + d]))
        scan = load_scan("sevenscenes", tmp_path, categories={"chair": "chair"})
        assert scan.frames[0].instances[20, 30] == owner


def test_a_chair_under_a_table_keeps_its_seat_and_the_table_its_top(tmp_path):
    folder = write_seven_scenes(tmp_path)
    upright = np.diag([1.0, -1.0, -1.0]).tolist()  # columns are the box's axes; its z is up
    chair = {"id": 0, "label": "chair", "rotation": upright, "size": [1.0, 1.0, 1.0]}
    table = {"id": 1, "label": "table", "rotation": upright, "size": [9.0, 9.0, 0.6]}
    for centre_z, owner in ((2.5 + 0.3 - 0.05, 2), (2.5, 1)):
        boxes = [{**chair, "centre": [0, 0, 2.5]}, {**table, "centre": [0, 0, centre_z]}]
        _edit(folder, lambda c, boxes=boxes: c.update(objects=boxes))
        assert load_scan("sevenscenes", tmp_path).frames[0].instances[20, 30] == owner


def test_bad_poses_are_left_out(tmp_path, caplog):
    folder = write_seven_scenes(tmp_path)
    write_matrix(folder / "frame-000001.pose.txt", np.full((4, 4), np.nan))
    write_matrix(folder / "frame-000002.pose.txt", 2 * pose())
    assert [frame.name for frame in load_scan("sevenscenes", tmp_path).frames] == ["frame-000000"]
    assert "frame-000001 is left out" in caplog.text
    assert "frame-000002 is left out" in caplog.text
    write_matrix(folder / "frame-000000.pose.txt", np.full((4, 4), np.inf))
    with pytest.raises(DatasetError, match="none of the 3 frames"):
        load_scan("sevenscenes", tmp_path)


def test_damaged_files_are_named(tmp_path):
    folder = write_seven_scenes(tmp_path)
    content = (folder / "frame-000000.depth.png").read_bytes()
    (folder / "frame-000000.depth.png").write_bytes(content[: len(content) // 2])
    scan = load_scan("sevenscenes", tmp_path)
    with pytest.raises(DatasetError, match=r"frame-000000\.depth\.png: no readable image"):
        scan.frames[0]
    write_matrix(folder / "camera-intrinsics.txt", camera_matrix(4 * WIDTH, 4 * HEIGHT)[:3, :3])
    with pytest.raises(DatasetError, match=r"camera-intrinsics\.txt: .*another resolution"):
        load_scan("sevenscenes", tmp_path).frames[1]


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.pop("up"),
        lambda c: c.update(up=[0, 1]),
        lambda c: c["objects"][0].pop("size"),
        lambda c: c["objects"][0].update(rotation=[1, 2]),
        lambda c: c["objects"][0].update(rotation=(2 * np.eye(3)).tolist()),
        lambda c: c["objects"][0].pop("label"),
    ],
)
def test_malformed_boxes_are_named(tmp_path, change):
    folder = write_seven_scenes(tmp_path)
    _edit(folder, change)
    with pytest.raises(DatasetError, match=r"instances\.json: no list of boxes"):
        load_scan("sevenscenes", tmp_path)


def test_missing_boxes_are_an_error(tmp_path):
    folder = write_seven_scenes(tmp_path)
    (folder / "instances.json").unlink()
    with pytest.raises(DatasetError, match=r"instances\.json: cannot be read"):
        load_scan("sevenscenes", tmp_path)
    write_bytes(folder / "instances.json", b"{")
    with pytest.raises(DatasetError, match="no valid JSON"):
        load_scan("sevenscenes", tmp_path)


def test_the_real_sequence(shared_data):
    scan = load_scan("sevenscenes", shared_data / "sevenscenes", "redkitchen", stride=60)
    assert [frame.name for frame in scan.frames] == ["frame-000000", "frame-000480", "frame-000960"]
    assert [instance.category for instance in scan.instances] == ["table"] + 5 * ["chair"]
    frame = scan.frames[0]
    assert frame.depth.max() < 10  # 65535 is no depth
    # the table fills much of the first picture, and its nearest leg is at the lower left
    assert np.count_nonzero(frame.instances == 1) > 50_000
    assert np.linalg.norm(scan.up_world) == pytest.approx(1)
