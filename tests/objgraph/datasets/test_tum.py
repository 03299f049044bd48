"""TUM RGB-D sequences: association by time, the known cameras, masks by either image's name, and what is missing."""

import logging

import numpy as np
import pytest

from objgraph.cli.main import main
from objgraph.datasets import load_scan, scenes
from objgraph.datasets.trajectory import Trajectory, read_tum, write_tum
from objgraph.datasets.tum import CAMERAS
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import (
    assert_scans_equal,
    frames_of,
    png,
    toy_scan,
    write_bytes,
    write_tum_sequence,
)


@pytest.fixture
def folder(tmp_path):
    return write_tum_sequence(tmp_path / "toy", toy_scan(6))


def load(folder, **options):
    return load_scan("tum", folder, **options)


def test_masks_may_be_named_after_either_image(tmp_path):
    for mask in ("depth", "rgb"):
        folder = write_tum_sequence(tmp_path / mask, toy_scan(), mask=mask)
        assert_scans_equal(load(folder), toy_scan(), 0.0002)
    assert scenes("tum", tmp_path) == ["depth", "rgb"]
    assert load_scan("tum", tmp_path, "rgb").name == "rgb"


def test_lists_may_be_written_on_windows(folder):
    for name in ("depth.txt", "rgb.txt"):
        text = (folder / name).read_text().replace("/", "\\").replace("\n", "\r\n")
        (folder / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert_scans_equal(load(folder), toy_scan(6), 0.0002)


def test_images_far_apart_in_time_are_no_pair(tmp_path):
    folder = write_tum_sequence(tmp_path / "late", toy_scan(), color_delay=0.025)
    # the colour image 25 ms after a depth image is 8 ms before the next one
    colors = [frame.color for frame in frames_of(load(folder))]
    assert colors[0] is None
    assert colors[1] is not None
    assert colors[1][5, 5, 0] == 200
    assert load(folder, max_difference=0.005).frames[1].color is None


def test_color_is_optional(folder):
    (folder / "rgb.txt").unlink()
    assert all(frame.color is None for frame in frames_of(load(folder)))


def test_every_other_frame(folder):
    first, _, third, _, fifth, _ = [frame.name for frame in frames_of(load(folder))]
    assert [frame.name for frame in frames_of(load(folder, stride=2))] == [first, third, fifth]


def test_another_trajectory_and_frames_without_a_pose(folder, caplog, tmp_path):
    truth = read_tum(folder / "groundtruth.txt")
    shifted = truth.T_world_camera[:4].copy()
    shifted[:, 2, 3] += 1
    write_tum(tmp_path / "slam.txt", Trajectory(truth.timestamps[:4], shifted))
    with caplog.at_level(logging.WARNING):
        scan = load(folder, trajectory=tmp_path / "slam.txt")
    assert len(scan.frames) == 2
    np.testing.assert_allclose(scan.frames[1].T_world_camera[2, 3], 2)
    assert "4 of 6 frames have no pose" in caplog.text
    write_tum(tmp_path / "slam.txt", Trajectory(truth.timestamps - 1e9, truth.T_world_camera))
    with pytest.raises(
        DatasetError, match=r"slam\.txt: no pose is within 0\.02 s .* from 1305031102\.160 to"
    ):
        load(folder, trajectory=tmp_path / "slam.txt")


def test_a_single_mask_is_enough(folder, caplog):
    kept, *others = sorted((folder / "masks").iterdir())
    for path in others:
        path.unlink()
    assert [frame.name for frame in frames_of(load(folder))] == [kept.stem]
    assert "5 of 6 frames have no mask" in caplog.text
    kept.unlink()
    with pytest.raises(DatasetError, match=r"none of the 6 depth images has a mask; write masks/NAME\.png"):
        load(folder)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_benchmarks_cameras_are_known_by_name(folder, name):
    (folder / "intrinsics.txt").unlink()
    with pytest.raises(DatasetError, match=r"no known camera \(freiburg1, .* write intrinsics\.txt"):
        load(folder)
    moved = folder.rename(folder.with_name(f"rgbd_dataset_{name}_desk"))
    # a tenth of the benchmark's resolution: the calibration is scaled to it
    fx, fy, cx, cy = np.array(CAMERAS[name]) / 10
    intrinsics = load(moved).frames[0].intrinsics
    assert (intrinsics.fx, intrinsics.fy) == pytest.approx((fx, fy))
    assert (intrinsics.cx + 0.5, intrinsics.cy + 0.5) == pytest.approx((cx + 0.05, cy + 0.05))


def test_intrinsics_and_depth_scale_by_option(folder, tmp_path):
    (tmp_path / "camera.json").write_text('{"fx": 70, "fy": 71, "cx": 30, "cy": 20, "depth_scale": 2500}')
    frame = load(folder, intrinsics=tmp_path / "camera.json").frames[0]
    assert (frame.intrinsics.fx, frame.intrinsics.cy) == (70, 20)
    assert frame.depth.max() == 4
    assert load(folder, depth_scale=1000).frames[0].depth.max() == 10


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("depth.txt", r"no scenes here; a scan's folder holds depth\.txt"),
        ("groundtruth.txt", r"no groundtruth\.txt; give the option trajectory"),
        ("instances.json", r"instances\.json: there is no such file"),
    ],
)
def test_missing_files_say_what_to_do(folder, path, message):
    (folder / path).unlink()
    with pytest.raises(DatasetError, match=message):
        load(folder)


@pytest.mark.parametrize(
    ("path", "content", "message"),
    [
        ("depth.txt", "# nothing\n", r"depth\.txt: names no image"),
        ("depth.txt", "1.5\n", r"depth\.txt, line 1: must be 'timestamp file'"),
        ("depth.txt", "#\nnow depth/a.png\n", r"depth\.txt, line 2: must be 'timestamp file'"),
        ("rgb.txt", "1.5 a b\n", r"rgb\.txt, line 1: must be 'timestamp file'"),
        ("groundtruth.txt", "now 1 2 3 0 0 0 1\n", r"groundtruth\.txt: a line begins with no timestamp"),
        ("intrinsics.txt", "1 2 3\n", r"intrinsics\.txt: holds 3 numbers instead of a 3x3 matrix"),
    ],
)
def test_damaged_files_are_named(folder, path, content, message):
    (folder / path).write_text(content)
    with pytest.raises(DatasetError, match=message):
        load(folder)


def depth_lines(folder, change):
    """Change the lines of `depth.txt`, (time, file) each, behind the comment."""
    path = folder / "depth.txt"
    comment, *lines = path.read_text().splitlines()
    changed = change([line.split() for line in lines])
    path.write_text("\n".join([comment, *(" ".join(words) for words in changed)]))


def test_images_that_share_a_time_are_told(folder, caplog):
    first, _, *others = load(folder).frames.names
    depth_lines(folder, lambda lines: [lines[0], [lines[0][0], lines[1][1]], *lines[2:]])
    assert load(folder).frames.names == (first, *others)
    assert "depth.txt: 1 frames share another's time and are left out" in caplog.text


def test_depth_images_of_the_same_name_are_refused(folder):
    def change(lines):
        (time, file), *others = lines
        again = f"more/{others[0][1]}"
        (folder / again).parent.mkdir(parents=True)
        (folder / file).rename(folder / again)
        return [[time, again], *others]

    depth_lines(folder, change)
    message = r"depth\.txt: the images at 1305031102\.16\d+ and 1305031102\.19\d+ s are both called 1305031102\.193733"
    with pytest.raises(DatasetError, match=message):
        load(folder)


def test_a_missing_or_wrong_image_is_named(folder):
    first, second, *_ = sorted((folder / "depth").iterdir())
    scan = load(folder)
    first.unlink()
    write_bytes(second, png(np.zeros((48, 64), np.uint8)))
    with pytest.raises(DatasetError, match=rf"{first.name}: cannot be read"):
        scan.frames[0]
    with pytest.raises(DatasetError, match=rf"{second.name}: depth must be a 16-bit"):
        scan.frames[1]


def test_stride_must_be_positive(folder):
    with pytest.raises(DatasetError, match="stride 0"):
        load(folder, stride=0)


def test_the_command_reads_a_sequence(folder, tmp_path, capsys):
    arguments = ["map", "--dataset", "tum", "--root", str(folder), "--categories", "zebra"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 1
    assert "toy has no object of zebra; its categories: chair, table" in capsys.readouterr().err
