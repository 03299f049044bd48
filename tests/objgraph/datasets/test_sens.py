"""ScanNet's `.sens` files, read a frame at a time."""

import numpy as np
import pytest

from objgraph.datasets import load_scan
from objgraph.datasets.files import fitted
from objgraph.datasets.sens import SensFile
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import (
    FOCAL,
    HEIGHT,
    SCENE,
    WIDTH,
    depth_image,
    mask_image,
    pose,
    sens_bytes,
    write_bytes,
    write_exported_scan,
    write_sens_scan,
)


@pytest.mark.parametrize("compression", [0, 1])
def test_round_trip(tmp_path, compression):
    path = tmp_path / "a.sens"
    path.write_bytes(sens_bytes(depth_compression=compression))
    sens = SensFile(path)
    assert len(sens) == 3
    assert (sens.header.sensor, sens.header.depth_size) == ("StructureSensor", (WIDTH, HEIGHT))
    for k in (2, 0, 1):
        expected = np.where(depth_image(k) == 65535, 0, depth_image(k)) / 1000
        np.testing.assert_allclose(sens.depth(k), expected)
        np.testing.assert_allclose(sens.pose(k), pose(k), atol=1e-6)
        np.testing.assert_allclose(fitted(sens.color(k), (HEIGHT, WIDTH))[5, 5], [200 + k, 40, 20], atol=4)


def test_both_forms_of_a_scan_give_the_same_frames(tmp_path):
    write_exported_scan(tmp_path / "exported")
    write_sens_scan(tmp_path / "sens", sens_bytes())
    exported, sens = (load_scan("scannet", tmp_path / form) for form in ("exported", "sens"))
    assert sens.instances == exported.instances
    assert len(sens.frames) == len(exported.frames) == 3
    for k in range(3):
        a, b = exported.frames[k], sens.frames[k]
        assert a.name == b.name
        assert a.intrinsics == b.intrinsics
        np.testing.assert_allclose(a.depth, b.depth)
        np.testing.assert_array_equal(a.instances, b.instances)
        np.testing.assert_allclose(a.T_world_camera, b.T_world_camera, atol=1e-6)
        np.testing.assert_array_equal(a.color, b.color)


def test_the_header_says_the_depths_units(tmp_path):
    (tmp_path / "a.sens").write_bytes(sens_bytes(depth_shift=5000.0))
    assert SensFile(tmp_path / "a.sens").depth(0)[20, 30] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"version": 3}, "version 3"),
        ({"color_compression": 0}, r"colour compression 0 \(raw\) is not read; readable: jpeg, png"),
        ({"color_compression": 7}, r"colour compression 7 \(unknown\)"),
        ({"depth_compression": 2}, r"depth compression 2 \(occi_ushort\) is not read"),
        ({"depth_compression": -1}, r"depth compression -1 \(unknown\)"),
        ({"depth_shift": 0.0}, "depth shift 0.0"),
        ({"depth_shift": float("nan")}, "depth shift nan"),
    ],
)
def test_what_is_not_read_is_said(tmp_path, settings, message):
    path = tmp_path / "odd.sens"
    path.write_bytes(sens_bytes(**settings))
    with pytest.raises(DatasetError, match=rf"odd\.sens: .*{message}"):
        SensFile(path)


@pytest.mark.parametrize(
    ("kept", "message"),
    [
        (0, "the header"),
        (10, "the header"),
        (200, "the header"),
        (400, "frame 0 of 3"),
        (-500, "frame 2 of 3"),
    ],
)
def test_a_truncated_file_names_the_frame(tmp_path, kept, message):
    path = tmp_path / "short.sens"
    path.write_bytes(sens_bytes()[:kept])
    with pytest.raises(DatasetError, match=rf"short\.sens: truncated in {message}"):
        SensFile(path)


def test_damage_inside_a_frame_names_the_frame(tmp_path):
    path = tmp_path / "a.sens"
    data = bytearray(sens_bytes())
    path.write_bytes(data)
    entry = SensFile(path)._entries[1]
    data[entry.offset : entry.offset + entry.color_bytes + entry.depth_bytes] = bytes(
        entry.color_bytes + entry.depth_bytes
    )
    path.write_bytes(data)
    sens = SensFile(path)
    with pytest.raises(DatasetError, match=r"a\.sens: frame 1: depth cannot be decompressed"):
        sens.depth(1)
    with pytest.raises(DatasetError, match=r"a\.sens: frame 1: no readable image"):
        sens.color(1)
    assert sens.depth(2).shape == (HEIGHT, WIDTH)


def test_a_missing_file_is_an_error(tmp_path):
    with pytest.raises(DatasetError, match=r"none\.sens: cannot be read"):
        SensFile(tmp_path / "none.sens")


def test_a_pose_of_infinity_leaves_the_frame_out(tmp_path, caplog):
    data = bytearray(sens_bytes())
    write_bytes(tmp_path / "a.sens", bytes(data))
    start = SensFile(tmp_path / "a.sens")._entries[1].offset - 16 * 4 - 4 * 8
    data[start : start + 64] = np.full(16, -np.inf, dtype="<f4").tobytes()
    write_sens_scan(tmp_path, bytes(data))
    assert [frame.name for frame in load_scan("scannet", tmp_path).frames] == ["0", "2"]
    assert "frame 1 is left out" in caplog.text


def test_the_archive_of_masks_is_asked_for(tmp_path):
    folder = write_sens_scan(tmp_path, sens_bytes())
    scan = load_scan("scannet", tmp_path)
    np.testing.assert_array_equal(scan.frames[0].instances, mask_image())
    assert scan.frames[0].intrinsics.fx == FOCAL
    (folder / "instance-filt").rename(folder / "elsewhere")
    with pytest.raises(DatasetError, match=rf"{SCENE}_2d-instance-filt\.zip"):
        load_scan("scannet", tmp_path)
