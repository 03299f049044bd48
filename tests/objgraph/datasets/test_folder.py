"""The plain folder: what is written is read, every file's faults are named, and the page's code writes one."""

import json
import logging
import re

import cv2
import numpy as np
import pytest

from objgraph.cli.main import main
from objgraph.datasets import load_scan, scannet, scenes
from objgraph.errors import DatasetError, ObservationError
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.conftest import REPOSITORY
from tests.objgraph.datasets.dataset_folders import (
    HEIGHT,
    WIDTH,
    assert_scans_equal,
    camera_matrix,
    color_image,
    depth_image,
    frames_of,
    jpeg,
    mask_image,
    pose,
    toy_scan,
    tum_words,
    write_bytes,
    write_matrix,
    write_plain_folder,
    write_tum_sequence,
)

SAMPLE = SampleConfig(seed=3, camera=CameraConfig(frames=4, width=80, height=60))


@pytest.fixture
def folder(tmp_path):
    return write_plain_folder(tmp_path / "toy", toy_scan())


def load(folder, **options):
    return load_scan("folder", folder, **options)


def names(scan):
    return [frame.name for frame in frames_of(scan)]


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def write_poses(folder, labels):
    lines = [f"{label} {tum_words(pose(k))}" for k, label in enumerate(labels)]
    (folder / "poses.txt").write_text("# name tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")


def rename(folder, new):
    for kind in ("depth", "masks", "color"):
        for path, name in zip(sorted((folder / kind).glob("*.png")), new, strict=True):
            path.rename(path.with_name(f"{name}.png"))


def test_the_sample_scene_survives_both_formats(tmp_path):
    scan = scannet.load(generate_sample(tmp_path / "sample", SAMPLE) / "scannet")
    write_plain_folder(tmp_path / "plain", scan)
    assert_scans_equal(load(tmp_path / "plain"), scan, 0.001)
    assert names(load(tmp_path / "plain")) == names(scan)
    write_plain_folder(tmp_path / "fine", scan, depth_scale=4000)
    assert_scans_equal(load(tmp_path / "fine"), scan, 0.00025)
    write_tum_sequence(tmp_path / "tum", scan)
    assert_scans_equal(load_scan("tum", tmp_path / "tum"), scan, 0.0002)


def test_a_scan_is_the_root_or_a_folder_in_it(folder):
    assert scenes("folder", folder) == ["toy"]
    assert load(folder).name == "toy"
    write_plain_folder(folder.parent / "other", toy_scan(1))
    assert scenes("folder", folder.parent) == ["other", "toy"]
    assert len(load_scan("folder", folder.parent, "other").frames) == 1
    with pytest.raises(DatasetError, match="several scenes: name one; available: other, toy"):
        load(folder.parent)


def test_poses_by_matrix(folder):
    (folder / "poses.txt").unlink()
    for k in range(3):
        write_matrix(folder / "pose" / f"{k:06d}.txt", pose(k))
    assert_scans_equal(load(folder), toy_scan(), 0)
    write_poses(folder, ["000000"])
    with pytest.raises(DatasetError, match=r"both poses\.txt and pose/: keep one"):
        load(folder)


def test_bad_matrices_are_left_out(folder, caplog):
    (folder / "poses.txt").unlink()
    write_matrix(folder / "pose" / "000000.txt", np.full((4, 4), np.nan))
    write_matrix(folder / "pose" / "000002.txt", pose(2))
    assert names(load(folder)) == ["000002"]
    assert "000000 is left out" in caplog.text
    assert "000001 is left out" in caplog.text


def test_a_line_belongs_to_the_frame_of_its_name_or_number(folder, caplog):
    write_poses(folder, ["0", "1", "2"])
    assert_scans_equal(load(folder), toy_scan(), 0)
    write_poses(folder, ["0", "1"])
    assert names(load(folder)) == ["000000", "000001"]
    assert "1 frames have no pose and are left out: 000002" in caplog.text


def test_of_a_name_and_a_number_the_name_counts(folder):
    write_poses(folder, ["0", "00001", "000001", "02", "2"])
    first, second, third = (frame.T_world_camera for frame in frames_of(load(folder)))
    for found, k in ((first, 0), (second, 2), (third, 3)):
        np.testing.assert_allclose(found, pose(k), atol=1e-12)  # of two numbers the first


def test_frame_1_is_not_the_pose_at_one_second(folder):
    write_poses(folder, ["0.000", "1.000", "2.000"])
    message = r"no line belongs to a frame: the frames are called 000000, .* begin with 0\.000.*in Python: max_difference"
    with pytest.raises(DatasetError, match=message):
        load(folder)


def test_a_line_belongs_to_the_frame_of_the_nearest_time(folder, caplog):
    rename(folder, ["100.00", "100.10", "100.20"])
    write_poses(folder, ["100.005", "1.00093e+02", "100.25"])
    scan = load(folder)
    assert names(scan) == ["100.00", "100.10"]
    np.testing.assert_allclose(scan.frames[1].T_world_camera, pose(1), atol=1e-12)
    assert "100.20" in caplog.text
    assert len(load(folder, max_difference=0.06).frames) == 3
    assert names(load(folder, max_difference=0.006)) == ["100.00"]


def test_another_trajectory(folder, tmp_path):
    own = tmp_path / "slam.txt"
    own.write_text(f"000001 {tum_words(pose(7))}\n")
    (scan,) = frames_of(load(folder, trajectory=own))
    assert scan.name == "000001"
    np.testing.assert_allclose(scan.T_world_camera, pose(7), atol=1e-12)


def test_frames_without_masks_are_left_out(folder, caplog):
    (folder / "masks" / "000001.png").unlink()
    with caplog.at_level(logging.WARNING):
        assert names(load(folder)) == ["000000", "000002"]
    assert "1 of 3 frames have no mask" in caplog.text
    assert names(load(folder, stride=2)) == ["000000"]


def test_no_masks_say_what_to_write(folder):
    for path in (folder / "masks").iterdir():
        path.unlink()
    with pytest.raises(DatasetError, match=r"none of the 3 depth images has a mask; .*masks/000000\.png"):
        load(folder)
    for name in ("mask_0.png", "mask_1.png", "mask_2.png", "mask_3.png"):
        (folder / "masks" / name).write_bytes(b"")
    with pytest.raises(
        DatasetError, match=r"masks/ has mask_0\.png, mask_1\.png, mask_2\.png, \.\.\.; write"
    ):
        load(folder)


def test_the_camera_in_text_or_of_another_size(folder):
    expected = toy_scan().frames[0].intrinsics
    json_file = folder / "intrinsics.json"
    edit(json_file, lambda c: c.update(fx=120, fy=120, cx=63.5, cy=47.5, width=2 * WIDTH, height=2 * HEIGHT))
    assert load(folder).frames[0].intrinsics == expected
    edit(json_file, lambda c: (c.pop("width"), c.pop("height")))
    with pytest.raises(DatasetError, match=r"intrinsics\.json: .*another resolution"):
        load(folder).frames[0]
    json_file.unlink()
    for text in ("60 60 31.5 23.5", "60 0 31.5\n0 60 23.5\n0 0 1", "\ufeff60 60 31.5 23.5\r\n"):
        (folder / "intrinsics.txt").write_text(text, encoding="utf-8")
        assert load(folder).frames[0].intrinsics == expected
    json_file.write_text("{}")
    with pytest.raises(DatasetError, match=r"both intrinsics\.json and intrinsics\.txt: keep one"):
        load(folder)


def test_no_distortion_may_be_said(folder):
    edit(folder / "intrinsics.json", lambda c: c.update(k1=0, p2=0.0, distortion=[0, 0, 0, 0], D=[]))
    assert load(folder).frames[0].intrinsics == toy_scan().frames[0].intrinsics


def test_two_objects_of_one_id_are_refused(folder):
    edit(folder / "instances.json", lambda c: c.update(instances={"2": "chair", "02": "table"}))
    with pytest.raises(ObservationError, match="several instances have the id 2; give each its own"):
        load(folder)
    (folder / "instances.json").write_text(
        '{"up_world": [0, 0, 1], "instances": {"2": "chair", "2": "table"}}'
    )
    with pytest.raises(DatasetError, match=r"instances\.json: no valid JSON \('2' is there twice\)"):
        load(folder)


def test_depth_is_in_millimetres_unless_said_otherwise(folder):
    edit(folder / "intrinsics.json", lambda c: c.pop("depth_scale"))
    assert load(folder).frames[0].depth.max() == 2
    assert load(folder, depth_scale=4000).frames[0].depth.max() == 0.5
    edit(folder / "intrinsics.json", lambda c: c.update(depth_scale=500))
    assert load(folder).frames[0].depth.max() == 4
    assert load(folder, depth_scale=1000).frames[0].depth.max() == 2
    for wrong in (0, -1, float("nan")):
        with pytest.raises(DatasetError, match=r"depth_scale .* must be the depth units in a metre"):
            load(folder, depth_scale=wrong)
    # what a RealSense calls its depth scale is metres a unit
    edit(folder / "intrinsics.json", lambda c: c.update(depth_scale=0.001))
    with pytest.raises(DatasetError, match=r"intrinsics\.json: depth_scale 0\.001 .*: write 1000"):
        load(folder)


@pytest.mark.parametrize("ending", ["jpg", "JPG", "jpeg", "JPEG"])
def test_color_is_optional_and_may_be_jpeg_of_another_size(folder, ending):
    for path in (folder / "color").iterdir():
        path.unlink()
    write_bytes(folder / "color" / f"000001.{ending}", jpeg(color_image(1, scale=2)))
    first, second, _ = frames_of(load(folder))
    assert first.color is None
    assert second.color is not None
    np.testing.assert_allclose(second.color[5, 5], [201, 40, 20], atol=4)


def test_masks_of_16_bits(folder):
    mask = 300 * mask_image().astype(np.uint16)
    cv2.imwrite(str(folder / "masks" / "000000.png"), mask)
    edit(folder / "instances.json", lambda c: c.update(instances={"900": "sofa", "300": "chair"}))
    scan = load(folder)
    assert [(i.id, i.category) for i in scan.instances] == [(300, "chair"), (900, "sofa")]
    np.testing.assert_array_equal(scan.frames[0].instances, mask)


def test_up_is_made_a_unit_vector(folder):
    edit(folder / "instances.json", lambda c: c.update(up_world=[0, 0, 1e300]))
    np.testing.assert_array_equal(load(folder).up_world, [0, 0, 1])
    edit(folder / "instances.json", lambda c: c.update(up_world=[0, -2, 0]))
    np.testing.assert_array_equal(load(folder).up_world, [0, -1, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("up_world"), "'up_world' is missing"),
        (lambda c: c.update(up=[0, -1, 0]), "up is not known, there are up_world, instances"),
        (lambda c: c.update(up_world=[0, 1]), "up_world must be three numbers"),
        (lambda c: c.update(up_world=[0, 0, 0]), "up_world must be three numbers"),
        (lambda c: c.update(up_world="up"), "could not convert"),
        (lambda c: c.update(up_world=[0, 0, float("inf")]), "up_world must be three numbers"),
        (lambda c: c.pop("instances"), "'instances' is missing"),
        (lambda c: c.update(instances={}), "names no instance"),
        (lambda c: c.update(instances=["chair"]), "names no categories by id"),
        (lambda c: c.update(instances={"one": "chair"}), "invalid literal"),
        (lambda c: c.update(instances={"0": "chair"}), "instance id 0 is no value of a mask"),
        (lambda c: c.update(instances={"1": " "}), "instance 1 has no category"),
        (lambda c: c.update(instances={"1": 7}), "instance 1 has no category"),
    ],
)
def test_malformed_instances_are_named(folder, change, message):
    edit(folder / "instances.json", change)
    with pytest.raises(DatasetError, match=message) as caught:
        load(folder)
    assert f"{folder}/instances.json" in str(caught.value)
    assert '"up_world": [0, 0, 1]' in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("fx"), "'fx' is missing"),
        (lambda c: c.update(cx="middle"), "could not convert"),
        (lambda c: c.update(width=0), "0x48 pixels"),
        (lambda c: c.pop("height"), "'height' is missing"),
        (lambda c: c.pop("width"), "'width' is missing"),
        (
            lambda c: c.update(depthScale=5000),
            "depthScale is not known, there are fx, .*, depth_scale: take it out",
        ),
        (lambda c: c.update(k1=0.26), "the lens distortion k1 is not corrected: undistort the images"),
        (lambda c: c.update(distortion=[0.26, 0]), "the lens distortion distortion is not corrected"),
        (lambda c: c.update(distortion={"k1": 1}), "float"),
    ],
)
def test_malformed_cameras_are_named(folder, change, message):
    edit(folder / "intrinsics.json", change)
    with pytest.raises(DatasetError, match=rf"intrinsics\.json: no camera \(.*{message}.*must read like"):
        load(folder)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("intrinsics.json", r"no intrinsics\.json; it must read like"),
        ("instances.json", r"instances\.json: there is no such file; it must read like"),
        ("poses.txt", r"no poses\.txt .*'NAME tx ty tz qx qy qz qw'"),
    ],
)
def test_missing_files_say_what_to_write(folder, path, message):
    (folder / path).unlink()
    with pytest.raises(DatasetError, match=message):
        load(folder)


@pytest.mark.parametrize(
    ("path", "content", "message"),
    [
        ("intrinsics.json", "{", "no valid JSON"),
        ("instances.json", "[1", "no valid JSON"),
        ("instances.json", "[1]", "list indices"),
        ("poses.txt", "", "holds no pose"),
        ("poses.txt", "000000 1 2 3\n", r"line 1: 4 words instead of the 8"),
        ("poses.txt", "\n000000 1 2 3 0 0 0 0\n", r"line 2: the quaternion's length is 0"),
        ("poses.txt", "000000 nan 2 3 0 0 0 1\n", r"line 1: the pose holds NaN .* delete the line"),
        ("poses.txt", "000000 1 2 x 0 0 0 1\n", r"line 1: could not convert"),
    ],
)
def test_damaged_files_are_named(folder, path, content, message):
    (folder / path).write_text(content)
    with pytest.raises(DatasetError, match=message) as caught:
        load(folder)
    assert str(folder / path) in str(caught.value)


@pytest.mark.parametrize(
    ("path", "image", "message"),
    [
        ("depth/000000.png", depth_image().astype(np.uint8), "depth must be a 16-bit"),
        ("masks/000000.png", color_image(), "a mask must be a one-channel"),
        ("masks/000000.png", mask_image().T.copy(), "other proportions"),
    ],
)
def test_images_of_another_kind_are_named(folder, path, image, message):
    cv2.imwrite(str(folder / path), image)
    with pytest.raises(DatasetError, match=message) as caught:
        load(folder).frames[0]
    assert str(folder / path) in str(caught.value)


def test_a_truncated_image_is_named(folder):
    path = folder / "depth" / "000002.png"
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(DatasetError, match=r"000002\.png: no readable image"):
        load(folder).frames[2]


def test_depth_in_another_format_is_named(folder):
    for path in (folder / "depth").iterdir():
        path.rename(path.with_suffix(".tiff"))
    with pytest.raises(DatasetError, match=r"depth: holds no NAME\.png"):
        load(folder)


def test_a_folder_of_something_else(tmp_path):
    with pytest.raises(DatasetError, match="no scenes here; a scan's folder holds depth"):
        load(tmp_path)
    with pytest.raises(DatasetError, match="absent: no such folder"):
        load(tmp_path / "absent")


def test_the_pages_code_writes_a_folder_that_is_read(tmp_path, monkeypatch):
    page = (REPOSITORY / "docs" / "guides" / "datasets.md").read_text()
    block = next(
        b for b in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "def write_frame" in b
    )
    names_there: dict = {}
    exec(compile(block, "datasets.md", "exec"), names_there)
    scan, root = toy_scan(), tmp_path / "toy"
    for frame in frames_of(scan):
        names_there["write_frame"](
            root, frame.name, frame.depth, frame.instances, frame.T_world_camera, frame.color
        )
    camera = camera_matrix()
    names_there["write_scan"](
        root, camera[0, 0], camera[1, 1], camera[0, 2], camera[1, 2], {1: "chair", 3: "table"}, [0, 0, 1]
    )
    assert_scans_equal(load(root), scan, 0.001)


def test_the_command_reads_a_folder(folder, tmp_path, capsys):
    out = tmp_path / "out"
    own = tmp_path / "slam.txt"
    own.write_text((folder / "poses.txt").read_text())
    arguments = ["map", "--dataset", "folder", "--root", str(folder), "--trajectory", str(own)]
    assert main([*arguments, "--categories", "zebra", "--out", str(out)]) == 1
    assert "toy has no object of zebra; its categories: chair, table" in capsys.readouterr().err
