"""BOP scenes: what is written is read, one object has one id in all images, and what is missing is named."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from objgraph.datasets import load_scan, scenes
from objgraph.datasets.files import LazyFrames
from objgraph.errors import DatasetError
from objgraph.observation.frames import Instance
from tests.objgraph.datasets.dataset_folders import assert_scans_equal, frames_of, pose, toy_scan, write_bop


def toy():
    """The toy scan with ids that follow one another."""
    scan = toy_scan()
    frames = {}
    for frame in frames_of(scan):
        frames[frame.name] = replace(frame, instances=np.where(frame.instances == 3, 2, frame.instances))
    return replace(
        scan,
        frames=LazyFrames(list(frames), frames.__getitem__),
        instances=(Instance(1, "chair"), Instance(2, "table")),
    )


def still(scan, nearer=5.0):
    """The same near a camera that does not move, so that its masks meet in the world, several pixels in a cell."""
    frames = {
        frame.name: replace(frame, depth=frame.depth / nearer, T_world_camera=pose(0))
        for frame in frames_of(scan)
    }
    return replace(scan, frames=LazyFrames(list(frames), frames.__getitem__))


@pytest.fixture
def folder(tmp_path):
    return write_bop(tmp_path / "000048", toy())


def load(folder, **options):
    return load_scan("bop", folder, **options)


def edit(folder, file, change):
    content = json.loads((folder / file).read_text())
    change(content)
    (folder / file).write_text(json.dumps(content))


def test_what_is_written_is_read(folder):
    assert_scans_equal(load(folder), toy(), 0.0001)
    assert scenes("bop", folder.parent) == ["000048"]
    assert load(folder, stride=2).frames.names == ("000000", "000002")


def test_one_file_of_categories_serves_all_scenes(folder):
    (folder / "instances.json").rename(folder.parent / "instances.json")
    assert_scans_equal(load(folder), toy(), 0.0001)


def test_objects_that_are_not_named_are_left_out(folder):
    edit(folder, "instances.json", lambda c: c["instances"].pop("1"))
    scan = load(folder)
    assert scan.instances == (Instance(1, "table"),)
    np.testing.assert_array_equal(scan.frames[1].instances == 1, toy().frames[1].instances == 2)
    edit(folder, "instances.json", lambda c: c.update(instances={"77": "chair"}))
    with pytest.raises(DatasetError, match=r"no image shows an object that instances\.json names"):
        load(folder)


def test_two_objects_of_one_id_are_told_apart_by_where_they_are(tmp_path):
    scan = still(toy())
    twins = replace(scan, instances=(Instance(1, "chair"), Instance(2, "chair")))
    read = load(write_bop(tmp_path / "twins", twins, {1: 7, 2: 7}))
    assert [each.category for each in read.instances] == ["chair", "chair"]
    left, right = ({frame.instances[20, u] for frame in frames_of(read)} for u in (25, 35))
    assert len(left) == len(right) == 1  # though their masks' numbers change places from image to image
    assert left | right == {1, 2}


def test_masks_that_cannot_be_told_apart_are_left_out_with_a_warning(tmp_path, caplog):
    scan = still(toy(), nearer=0.5)  # no two pixels in a cell
    twins = replace(scan, instances=(Instance(1, "chair"), Instance(2, "chair")))
    assert load(write_bop(tmp_path / "far", twins, {1: 7, 2: 7})).instances == ()
    assert "6 masks show too little" in caplog.text


def test_an_object_that_is_alone_needs_no_points_that_meet(tmp_path):
    """Seen from two sides: no point of one view is near one of the other."""
    scan = toy()
    frames = {}
    for k, frame in enumerate(frames_of(scan)):
        away = np.eye(4)
        away[0, 3] = 10.0 * k
        frames[frame.name] = replace(frame, T_world_camera=away)
    scan = replace(scan, frames=LazyFrames(list(frames), frames.__getitem__))
    assert_scans_equal(load(write_bop(tmp_path / "away", scan)), scan, 0.0001)


def test_no_pose_of_an_object_is_read(folder):
    junk = {"cam_R_m2c": "none", "cam_t_m2c": None}
    edit(folder, "scene_gt.json", lambda c: [each.update(junk) for image in c.values() for each in image])
    assert_scans_equal(load(folder), toy(), 0.0001)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("scene_camera.json", lambda c: c["0"].pop("cam_R_w2c"), "without camera poses cannot be mapped"),
        (
            "scene_camera.json",
            lambda c: c["0"].update(cam_R_w2c=[0] * 9),
            "its pose cannot be used: it is not rigid",
        ),
        ("scene_camera.json", lambda c: c["0"].update(cam_t_w2c=[1]), "image 0: .* is damaged"),
        ("scene_camera.json", lambda c: c["0"].pop("cam_K"), "image 0: .* is damaged"),
        ("scene_camera.json", lambda c: c["1"].update(cam_K=[0] * 9), "image 1: no camera"),
        ("scene_camera.json", lambda c: c["1"].update(depth_scale=0), "image 1: no camera .*depth_scale 0"),
        (
            "scene_camera.json",
            lambda c: c.update(first={}),
            "must have an entry for each image by its number",
        ),
        ("scene_gt.json", lambda c: c["2"].append({}), "image 2 is no list of objects with an obj_id"),
        ("scene_gt.json", lambda c: c.clear(), "no image shows an object"),
    ],
)
def test_what_is_wrong_is_named(folder, file, change, message):
    edit(folder, file, change)
    with pytest.raises(DatasetError, match=message) as caught:
        load(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    "path", ["scene_gt.json", "instances.json", "depth/000000.png", "mask_visib/000000_000001.png"]
)
def test_missing_files_are_named(folder, path):
    (folder / path).unlink()
    with pytest.raises(DatasetError) as caught:
        load(folder).frames[0]
    assert path.split("/")[-1] in str(caught.value)


anything = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=9) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=9,
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["cam_K", "cam_R_w2c", "cam_t_w2c", "depth_scale"]), anything)
def test_any_value_is_read_or_refused(folder, key, value):
    original = (folder / "scene_camera.json").read_text()
    edit(folder, "scene_camera.json", lambda c: c["1"].update({key: value}))
    try:
        frames_of(load(folder))
    except DatasetError as error:
        named = str(error)
    else:
        named = str(folder)
    (folder / "scene_camera.json").write_text(original)
    assert str(folder) in named
