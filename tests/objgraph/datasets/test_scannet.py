"""ScanNet's exported folders: what is read, and what damaged folders give."""

import json
import logging
import zipfile

import cv2
import numpy as np
import pytest

from objgraph.datasets import load_scan
from objgraph.datasets.ground_truth import annotated
from objgraph.errors import DatasetError
from objgraph.observation.frames import Instance
from tests.objgraph.datasets.dataset_folders import (
    FOCAL,
    HEIGHT,
    SCENE,
    WIDTH,
    camera_matrix,
    mask_image,
    png,
    pose,
    write_bytes,
    write_exported_scan,
    write_labels,
    write_matrix,
)


def test_frames_are_read_in_metres_at_the_depth_resolution(tmp_path):
    write_exported_scan(tmp_path, 12)
    scan = load_scan("scannet", tmp_path)
    frame = scan.frames[2]
    assert [scan.frames[k].name for k in (0, 2, 11)] == ["0", "2", "11"]
    assert frame.depth[20, 30] == pytest.approx(1.502)
    assert frame.depth[0, 0] == 0
    assert frame.depth[0, 1] == 0  # 65535 is no depth either
    np.testing.assert_allclose(frame.T_world_camera, pose(2), atol=1e-12)
    np.testing.assert_array_equal(frame.instances, mask_image())
    assert frame.color is not None
    assert frame.color.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(frame.color[5, 5], [202, 40, 20], atol=4)
    assert (frame.intrinsics.fx, frame.intrinsics.cx) == (FOCAL, (WIDTH - 1) / 2)
    np.testing.assert_array_equal(scan.up_world, [0, 0, 1])
    with pytest.raises(IndexError):
        scan.frames[12]


def test_labels_become_categories(tmp_path, caplog):
    folder = write_exported_scan(tmp_path)
    scan = load_scan("scannet", tmp_path)
    assert scan.instances == (Instance(1, "chair"), Instance(2, "trash_bin"), Instance(3, "table"))
    with caplog.at_level(logging.INFO):
        scan = load_scan("scannet", tmp_path, categories={"office chair": "chair"})
    assert scan.instances == (Instance(1, "chair"),)
    assert "left out, no category for their labels: " in caplog.text
    assert "trash can" in caplog.text
    scan = load_scan("scannet", tmp_path, categories={"trash can": "bin"})
    assert scan.instances == (Instance(2, "bin"),)
    (folder / f"{SCENE}.aggregation.json").unlink()
    write_labels(folder, "_vh_clean")
    assert len(load_scan("scannet", tmp_path).instances) == 3


def test_the_room_itself_is_no_object(tmp_path):
    folder = write_exported_scan(tmp_path)
    labels = {0: "wall", 1: "recycling bin", 2: "floor", 3: "piano"}
    groups = [{"id": k, "objectId": k, "segments": [k], "label": label} for k, label in labels.items()]
    write_bytes(folder / f"{SCENE}.aggregation.json", json.dumps({"segGroups": groups}).encode())
    assert load_scan("scannet", tmp_path).instances == (Instance(2, "trash_bin"), Instance(4, "piano"))
    wall = load_scan("scannet", tmp_path, categories={"wall": "wall"})
    assert wall.instances == (Instance(1, "wall"),)


def test_masks_of_the_colour_camera_are_resized(tmp_path):
    folder = write_exported_scan(tmp_path)
    large = np.kron(mask_image(), np.ones((2, 2), dtype=np.uint8))
    write_bytes(folder / "instance-filt" / "0.png", png(large))
    write_bytes(folder / "instance-filt" / "1.png", png(mask_image()[:, :40]))
    scan = load_scan("scannet", tmp_path)
    np.testing.assert_array_equal(scan.frames[0].instances, mask_image())
    with pytest.raises(DatasetError, match=r"1\.png: the mask is 40x48 pixels.*64x48"):
        scan.frames[1]


def test_resized_masks_hold_no_other_ids(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    # ScanNet's colour camera has 1296x968 pixels, its depth camera 640x480: no whole ratio
    large = cv2.resize(mask_image(), (130, 97), interpolation=cv2.INTER_NEAREST)
    write_bytes(folder / "instance-filt" / "0.png", png(large))
    ids = load_scan("scannet", tmp_path).frames[0].instances
    assert set(np.unique(ids)) == {0, 1, 3}
    assert np.count_nonzero(ids != mask_image()) < 60  # at most the outline moves


def test_masks_from_the_archive(tmp_path):
    folder = write_exported_scan(tmp_path)
    with zipfile.ZipFile(folder / f"{SCENE}_2d-instance-filt.zip", "w") as archive:
        archive.write(folder / "instance-filt" / "0.png", "instance-filt/0.png")
    for path in (folder / "instance-filt").iterdir():
        path.unlink()
    (folder / "instance-filt").rmdir()
    scan = load_scan("scannet", tmp_path)
    np.testing.assert_array_equal(scan.frames[0].instances, mask_image())
    with pytest.raises(DatasetError, match=r"instance-filt/1\.png"):
        scan.frames[1]


def _spoil(matrix, row, column, value):
    matrix = matrix.copy()
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (_spoil(pose(), 0, 3, np.nan), "NaN or infinity"),
        (np.full((4, 4), -np.inf), "NaN or infinity"),
        (_spoil(pose(), 0, 0, 1.1), "not rigid"),
        (_spoil(pose(), 3, 3, 2.0), "not rigid"),
        (_spoil(pose(), 2, 2, -1.0), "reflection"),
        (np.eye(3), "9 numbers"),
    ],
)
def test_a_frame_without_a_pose_is_left_out(tmp_path, caplog, bad, reason):
    folder = write_exported_scan(tmp_path, 3)
    write_matrix(folder / "pose" / "1.txt", bad)
    scan = load_scan("scannet", tmp_path)
    assert [frame.name for frame in scan.frames] == ["0", "2"]
    assert "frame 1 is left out" in caplog.text
    assert reason in caplog.text


def test_a_missing_pose_file_is_left_out(tmp_path, caplog):
    folder = write_exported_scan(tmp_path, 2)
    (folder / "pose" / "0.txt").unlink()
    assert len(load_scan("scannet", tmp_path).frames) == 1
    assert "0.txt" in caplog.text


def test_slightly_inexact_rotations_become_exact(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    write_matrix(folder / "pose" / "0.txt", _spoil(pose(), 0, 1, 1e-3))
    rotation = load_scan("scannet", tmp_path).frames[0].T_world_camera[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)


def test_no_usable_frame_is_an_error(tmp_path):
    folder = write_exported_scan(tmp_path, 2)
    for k in range(2):
        write_matrix(folder / "pose" / f"{k}.txt", np.full((4, 4), -np.inf))
    with pytest.raises(DatasetError, match=rf"{SCENE}: none of the 2 frames"):
        load_scan("scannet", tmp_path)
    for path in (folder / "depth").iterdir():
        path.unlink()
    with pytest.raises(DatasetError, match=rf"{SCENE}: none of the 0 frames"):
        load_scan("scannet", tmp_path)


@pytest.mark.parametrize("name", ["depth/1.png", "instance-filt/1.png"])
@pytest.mark.parametrize("share", [0, 0.5])
def test_a_truncated_image_is_named(tmp_path, name, share):
    folder = write_exported_scan(tmp_path)
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: int(share * len(content))])
    scan = load_scan("scannet", tmp_path)
    with pytest.raises(DatasetError, match=rf"{name}: no readable image"):
        scan.frames[1]


def test_missing_files_are_named(tmp_path):
    folder = write_exported_scan(tmp_path)
    (folder / "instance-filt" / "1.png").unlink()
    (folder / "color" / "0.jpg").unlink()
    scan = load_scan("scannet", tmp_path)
    assert scan.frames[0].color is None
    with pytest.raises(DatasetError, match=r"instance-filt/1\.png: cannot be read"):
        scan.frames[1]
    (folder / "intrinsic" / "intrinsic_depth.txt").unlink()
    with pytest.raises(DatasetError, match=r"intrinsic_depth\.txt: cannot be read"):
        load_scan("scannet", tmp_path).frames[0]
    (folder / f"{SCENE}.aggregation.json").unlink()
    with pytest.raises(DatasetError, match=r"no scene0001_00\.aggregation\.json"):
        load_scan("scannet", tmp_path)


def test_no_masks_or_recording_is_an_error(tmp_path):
    folder = write_exported_scan(tmp_path)
    (folder / "instance-filt").rename(folder / "elsewhere")
    with pytest.raises(DatasetError, match="no instance masks"):
        load_scan("scannet", tmp_path)
    write_bytes(folder / f"{SCENE}_2d-instance-filt.zip", b"no archive")
    with pytest.raises(DatasetError, match="no readable zip archive"):
        load_scan("scannet", tmp_path)
    (folder / "depth").rename(folder / "unknown")
    with pytest.raises(DatasetError, match=r"neither exported folders .* nor scene0001_00\.sens"):
        load_scan("scannet", tmp_path)


def test_an_archive_whose_names_are_no_text_is_named(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    (folder / "instance-filt").rename(folder / "elsewhere")
    archive = folder / f"{SCENE}_2d-instance-filt.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("\u00e9.png", b"")
    archive.write_bytes(archive.read_bytes().replace("\u00e9".encode(), b"\xeb\xeb"))
    with pytest.raises(DatasetError, match="no readable zip archive"):
        load_scan("scannet", tmp_path)


@pytest.mark.parametrize(
    "line", ["depthWidth = 0", "depthWidth = 6e999", "depthWidth = 64.5", "depthShift = 1e999"]
)
def test_sizes_and_units_that_cannot_be_are_named(tmp_path, line):
    folder = write_exported_scan(tmp_path, 1)
    write_bytes(folder / f"{SCENE}.txt", f"depthWidth = 64\ndepthHeight = 48\n{line}\n".encode())
    with pytest.raises(DatasetError, match=r"scene0001_00.*(0x48 pixels|no size|depth shift)"):
        load_scan("scannet", tmp_path).frames[0]


def test_depth_must_have_16_bits(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    write_bytes(folder / "depth" / "0.png", png(mask_image()))
    with pytest.raises(DatasetError, match=r"0\.png: depth must be a 16-bit"):
        load_scan("scannet", tmp_path).frames[0]


@pytest.mark.parametrize("content", [b"{", b"[]", b'{"segGroups": [{"objectId": "x", "label": "chair"}]}'])
def test_a_damaged_aggregation_is_named(tmp_path, content):
    folder = write_exported_scan(tmp_path, 1)
    write_bytes(folder / f"{SCENE}.aggregation.json", content)
    with pytest.raises(DatasetError, match=r"aggregation\.json"):
        load_scan("scannet", tmp_path)


def test_intrinsics_of_another_resolution(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    write_matrix(
        folder / "intrinsic" / "intrinsic_depth.txt", camera_matrix(2 * WIDTH, 2 * HEIGHT, 2 * FOCAL)
    )
    with pytest.raises(
        DatasetError, match=r"intrinsic_depth\.txt: the principal point .* another resolution"
    ):
        load_scan("scannet", tmp_path).frames[0]
    info = f"depthHeight = {2 * HEIGHT}\ndepthWidth = {2 * WIDTH}\nsceneType = Office\n"
    write_bytes(folder / f"{SCENE}.txt", info.encode())
    intrinsics = load_scan("scannet", tmp_path).frames[0].intrinsics
    assert (intrinsics.fx, intrinsics.fy) == (FOCAL, FOCAL)
    assert (intrinsics.cx, intrinsics.cy) == ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    write_bytes(folder / f"{SCENE}.txt", b"depthHeight = 100\ndepthWidth = 300\n")
    with pytest.raises(DatasetError, match=r"for 300x100 pixels, the images have 64x48"):
        load_scan("scannet", tmp_path).frames[0]


def test_no_camera_matrix(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    for bad, message in (
        (np.zeros((4, 4)), "no camera matrix"),
        (np.full((4, 4), np.nan), "no camera matrix"),
    ):
        write_matrix(folder / "intrinsic" / "intrinsic_depth.txt", bad)
        with pytest.raises(DatasetError, match=message):
            load_scan("scannet", tmp_path).frames[0]
    write_bytes(folder / "intrinsic" / "intrinsic_depth.txt", b"fx = 3")
    with pytest.raises(DatasetError, match="no matrix of numbers"):
        load_scan("scannet", tmp_path).frames[0]


def test_depth_units_from_the_scan_file(tmp_path):
    folder = write_exported_scan(tmp_path, 1)
    write_bytes(folder / f"{SCENE}.txt", b"appVersionId = 1.0.0\r\ndepthShift = 5000.0 \r\n")
    assert load_scan("scannet", tmp_path).frames[0].depth[20, 30] == pytest.approx(0.3)
    write_bytes(folder / f"{SCENE}.txt", b"depthShift = 0\n")
    with pytest.raises(DatasetError, match="depth shift 0"):
        load_scan("scannet", tmp_path).frames[0]


def test_without_annotations_there_is_no_ground_truth(tmp_path, caplog):
    write_exported_scan(tmp_path / "scannet", 1)
    scan = load_scan("scannet", tmp_path / "scannet")
    with caplog.at_level(logging.INFO):
        assert dict(annotated(scan).ground_truth) == {}
    assert "no ground truth" in caplog.text
    write_bytes(tmp_path / "scan2cad" / "full_annotations.json", json.dumps([{"id_scan": "other"}]).encode())
    assert len(annotated(load_scan("scannet", tmp_path / "scannet")).ground_truth) == 0


def test_the_real_scan(shared_data):
    scan = load_scan("scannet", shared_data / "scannet", "scene0470_00")
    assert len(scan.frames) == 48
    categories = {instance.id: instance.category for instance in scan.instances}
    assert categories == {
        1: "trash_bin",
        2: "chair",
        3: "chair",
        4: "chair",
        5: "chair",
        6: "table",
        7: "chair",
    }
    frame = scan.frames[0]
    assert 0.5 < np.median(frame.depth[frame.depth > 0]) < 4
    assert set(np.unique(frame.instances)) <= set(range(8))
    assert frame.intrinsics.fx == pytest.approx(577.87)
