"""nerfstudio's format: axes, pixel centres, units, cameras a frame, and what is refused."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from objgraph.datasets import load_scan, scenes
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import (
    assert_scans_equal,
    frames_of,
    toy_scan,
    write_nerfstudio,
)


@pytest.fixture
def folder(tmp_path):
    return write_nerfstudio(tmp_path / "toy", toy_scan())


def load(folder, **options):
    return load_scan("nerfstudio", folder, **options)


def edit(folder, change, file="transforms.json"):
    content = json.loads((folder / file).read_text())
    change(content)
    (folder / file).write_text(json.dumps(content))


def test_what_is_written_is_read(folder):
    assert_scans_equal(load(folder), toy_scan(), 0)
    assert scenes("nerfstudio", folder.parent) == ["toy"]
    assert load(folder, stride=2).frames.names == ("frame_00000", "frame_00002")


def test_a_camera_looks_along_its_own_minus_z(folder):
    identity = np.eye(4).tolist()
    edit(folder, lambda c: c["frames"][0].update(transform_matrix=identity))
    np.testing.assert_array_equal(load(folder).frames[0].T_world_camera, np.diag([1, -1, -1, 1]))
    edit(folder, lambda c: c["frames"][0].update(transform_matrix=identity[:3]))
    np.testing.assert_array_equal(load(folder).frames[0].T_world_camera, np.diag([1, -1, -1, 1]))


def test_an_image_of_a_centred_camera_is_the_same_on_both_sides(folder):
    """Half of the width is nerfstudio's middle; here it is between the two pixels in the middle."""
    edit(folder, lambda c: c.update(cx=32, cy=24))
    intrinsics = load(folder).frames[0].intrinsics
    left, right = intrinsics.backproject(np.array([0, 63]), np.array([0, 47]))
    np.testing.assert_allclose(left[:2], -right[:2])


def test_a_frame_may_have_its_own_camera_of_another_resolution(folder):
    edit(folder, lambda c: c["frames"][1].update(fl_x=240, fl_y=240, cx=128, cy=96, w=256, h=192))
    first, second, _ = frames_of(load(folder))
    assert first.intrinsics == second.intrinsics  # scaled to the depth image


def test_units_of_depth(folder):
    edit(folder, lambda c: c.update(depth_unit_scale_factor=0.002))
    assert load(folder).frames[0].depth.max() == 4


def test_z_is_up_unless_said_otherwise(folder):
    edit(folder, lambda c: c.pop("up_world"), "instances.json")
    np.testing.assert_array_equal(load(folder).up_world, [0, 0, 1])
    edit(folder, lambda c: c.update(up_world=[0, 2, 0]), "instances.json")
    np.testing.assert_array_equal(load(folder).up_world, [0, 1, 0])


def test_distortion_of_zeros_is_none(folder):
    edit(folder, lambda c: c.update(distortion_params=[0.0] * 6))
    assert_scans_equal(load(folder), toy_scan(), 0)


@pytest.mark.parametrize("form", ["frame_{:05d}", "1305031102.{:05d}"])
def test_names_may_lack_their_endings(folder, form):
    """As those of Blender's exporters do; what is behind a point in them is no ending."""
    for k in range(3):
        for kind in ("images", "masks"):
            path = folder / kind / f"frame_{k:05d}.png"
            path.rename(path.with_name(f"{form.format(k)}.png"))
        edit(
            folder,
            lambda c, k=k: c["frames"][k].update(
                file_path=f"./images/{form.format(k)}", depth_file_path=f"depths/depth_{k:05d}"
            ),
        )
    scan = load(folder)
    assert scan.frames.names == tuple(form.format(k) for k in range(3))
    for frame, expected in zip(frames_of(scan), frames_of(toy_scan()), strict=True):
        assert frame.color is not None
        np.testing.assert_array_equal(frame.color, expected.color)
        np.testing.assert_array_equal(frame.depth, expected.depth)


def test_masks_may_be_named_after_depth_and_colour_may_be_missing(folder):
    for path in (folder / "masks").iterdir():
        path.rename(path.with_name(path.name.replace("frame", "depth")))
    for path in (folder / "images").iterdir():
        path.unlink()
    assert [frame.color for frame in frames_of(load(folder))] == [None] * 3


def test_frames_without_depth_or_a_usable_pose_are_left_out(folder, caplog):
    edit(folder, lambda c: c["frames"][0].pop("depth_file_path"))
    edit(folder, lambda c: c["frames"][1].update(transform_matrix=[[1, 2], [3, 4]]))
    assert load(folder).frames.names == ("frame_00002",)
    assert "1 frames have no depth_file_path" in caplog.text
    assert "frame_00001 is left out" in caplog.text
    edit(folder, lambda c: [frame.pop("depth_file_path", None) for frame in c["frames"]])
    with pytest.raises(DatasetError, match="no frame has a depth_file_path; export the scan with depth"):
        load(folder)


@pytest.mark.parametrize(
    "name", ["../secret.png", "images/../../secret.png", "{}/secret.png", "link/secret.png"]
)
@pytest.mark.parametrize("key", ["file_path", "depth_file_path"])
def test_files_outside_of_the_folder_are_refused(folder, key, name):
    (folder.parent / "secret.png").write_bytes(b"")
    (folder / "link").symlink_to(folder.parent)
    edit(folder, lambda c: c["frames"][0].update({key: name.replace("{}", str(folder.parent))}))
    with pytest.raises(DatasetError, match=r"transforms\.json: frame 0: .* lies outside of"):
        load(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(k1=0.1, p2=0.01), r"frame 0: lens distortion \(k1, p2\) is not corrected"),
        (
            lambda c: c.update(distortion_params=[0.0, 0.1]),
            r"lens distortion \(distortion_params\[1\]\) is not",
        ),
        (
            lambda c: c["frames"][0].update(distortion_params=[0.1] + [0] * 5),
            r"frame 0: .*distortion_params\[0\]",
        ),
        (lambda c: c.update(distortion_params=None), r"distortion_params\[0\] must be a number, not None"),
        (lambda c: c.update(camera_model="OPENCV_FISHEYE"), "camera_model OPENCV_FISHEYE is not corrected"),
        (lambda c: c.update(applied_scale=0.3), "its poses were scaled by 0.3: export it in metres"),
        (lambda c: c.update(depth_unit_scale_factor=0), "must be the metres in a unit"),
        (lambda c: c.pop("fl_x"), "frame 0: fl_x must be a number, not None"),
        (lambda c: c.update(cx="middle"), "frame 0: cx must be a number, not 'middle'"),
        (lambda c: c.update(w=0), "images of 0x48 pixels"),
        (lambda c: c.update(frames={}), "has no list of frames"),
        (lambda c: c.update(frames=[3]), "frame 0: must have a file_path"),
        (lambda c: c["frames"][0].update(file_path=3), "frame 0: 3 is no file's name"),
        (lambda c: c["frames"].append(c["frames"][0]), "frame 3: its image is called frame_00000 as that of"),
    ],
)
def test_what_is_wrong_is_named(folder, change, message):
    edit(folder, change)
    with pytest.raises(DatasetError, match=message) as caught:
        load(folder)
    assert f"{folder}/transforms.json" in str(caught.value)


anything = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=6,
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(
        ["frames", "fl_x", "cy", "w", "k2", "distortion_params", "camera_model", "depth_unit_scale_factor"]
    ),
    anything,
)
def test_any_value_is_read_or_refused(folder, key, value):
    original = (folder / "transforms.json").read_text()
    edit(folder, lambda c: c.update({key: value}))
    check(folder, original)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["file_path", "depth_file_path", "transform_matrix", "cx", "h"]), anything)
def test_any_value_of_a_frame_is_read_or_refused(folder, key, value):
    original = (folder / "transforms.json").read_text()
    edit(folder, lambda c: c["frames"][0].update({key: value}))
    check(folder, original)


def check(folder, original):
    try:
        frames_of(load(folder))
    except DatasetError as error:
        named = str(error)
    else:
        named = str(folder)
    (folder / "transforms.json").write_text(original)
    assert str(folder) in named
