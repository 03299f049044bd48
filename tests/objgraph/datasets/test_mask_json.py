"""Masks in JSON: COCO's run lengths there and back, polygons, overlaps, and what has no id."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from objgraph.datasets import load_scan
from objgraph.datasets.mask_json import decode_rle, read_mask_json
from objgraph.errors import DatasetError
from tests.objgraph.datasets.dataset_folders import (
    HEIGHT,
    WIDTH,
    assert_scans_equal,
    toy_scan,
    write_nerfstudio,
    write_plain_folder,
    write_tum_sequence,
)

SHAPE = (HEIGHT, WIDTH)


def runs_of(mask):
    """Lengths of the runs down the columns, the first of them outside."""
    flat = np.concatenate([[False], mask.T.ravel()])
    edges = np.flatnonzero(np.diff(flat))
    return np.diff(np.concatenate([[0], edges, [mask.size]])).tolist()


def compressed(runs):
    """As the COCO API's description has it: differences to the last but one, five bits a character."""
    text = ""
    for k, run in enumerate(runs):
        value = run - runs[k - 2] if k > 2 else run
        while True:
            bits = value & 0x1F
            value >>= 5
            more = value != (-1 if bits & 0x10 else 0)
            text += chr(48 + bits + (0x20 if more else 0))
            if not more:
                break
    return text


def written(path, entries):
    path.write_text(json.dumps(entries))
    return path


def test_runs_go_down_the_columns():
    expected = [[False, True, False], [True, False, False]]
    np.testing.assert_array_equal(decode_rle([2, 3], [1, 2, 3]), expected)
    np.testing.assert_array_equal(decode_rle([2, 3], "123"), expected)
    np.testing.assert_array_equal(decode_rle([2, 1], [0, 2]), [[True], [True]])


def test_strings_made_by_hand_are_read():
    """16 takes two characters, for its highest bit would be its sign; -2, from 3 to 1, is 'N'."""
    np.testing.assert_array_equal(decode_rle([4, 5], "`04").T.ravel(), [False] * 16 + [True] * 4)
    np.testing.assert_array_equal(
        decode_rle([10, 1], "234N").ravel(), [False] * 2 + [True] * 3 + [False] * 4 + [True]
    )


@given(arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=90)))
def test_every_mask_comes_back(mask):
    runs = runs_of(mask)
    np.testing.assert_array_equal(decode_rle(mask.shape, runs), mask)
    np.testing.assert_array_equal(decode_rle(mask.shape, compressed(runs)), mask)


def test_long_runs_come_back():
    mask = np.zeros((1080, 1920), bool)
    mask[:, 900:] = True
    assert decode_rle(mask.shape, compressed(runs_of(mask))).tolist() == mask.tolist()


def test_a_smaller_mask_lies_over_a_larger_one(tmp_path):
    large, small = [[10, 10, 40, 10, 40, 30, 10, 30]], [[20, 15, 30, 15, 30, 25, 20, 25]]
    entries = [{"segmentation": small, "id": 7}, {"segmentation": large, "instance_id": 300, "id": 9}]
    ids = read_mask_json(written(tmp_path / "m.json", entries), SHAPE)
    assert set(np.unique(ids)) == {0, 7, 300}
    assert (ids[15:26, 20:31] == 7).all()
    assert ids[10, 10] == ids[30, 40] == 300
    assert ids[9, 10] == 0


def test_polygons_of_one_object_that_overlap_are_one(tmp_path):
    square, shifted = [10, 10, 20, 10, 20, 20, 10, 20], [15, 15, 25, 15, 25, 25, 15, 25]
    ids = read_mask_json(written(tmp_path / "m.json", [{"segmentation": [square, shifted], "id": 1}]), SHAPE)
    assert ids[17, 17] == 1


def test_polygons_may_reach_beyond_the_image_by_a_pixel_or_two(tmp_path):
    height, width = SHAPE
    border = [-2, -1.5, width, 0, width + 1, height + 2, 0, height]
    assert read_mask_json(written(tmp_path / "m.json", [{"segmentation": [border], "id": 1}]), SHAPE)[
        1:
    ].all()


def test_no_masks_are_no_objects(tmp_path):
    assert not read_mask_json(written(tmp_path / "m.json", []), SHAPE).any()


def in_json(folder):
    """Each mask image of a scan as run lengths."""
    for path in list((folder / "masks").glob("*.png")):
        ids = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
        entries = [
            {
                "segmentation": {"size": list(ids.shape), "counts": compressed(runs_of(ids == i))},
                "instance_id": int(i),
            }
            for i in np.unique(ids[ids > 0])
        ]
        written(path.with_suffix(".json"), entries)
        path.unlink()
    return folder


@pytest.mark.parametrize(
    ("dataset", "write"),
    [("folder", write_plain_folder), ("tum", write_tum_sequence), ("nerfstudio", write_nerfstudio)],
)
def test_folders_take_them_for_images(tmp_path, dataset, write):
    assert_scans_equal(load_scan(dataset, in_json(write(tmp_path / "toy", toy_scan()))), toy_scan(), 0.0002)


def test_masks_of_the_colour_cameras_resolution_are_resized(tmp_path):
    folder = write_plain_folder(tmp_path / "toy", toy_scan())
    for path in (folder / "masks").glob("*.png"):
        ids = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
        cv2.imwrite(str(path), ids.repeat(2, axis=0).repeat(2, axis=1))
    assert_scans_equal(load_scan("folder", in_json(folder)), toy_scan(), 0)


RLE = {"size": [2, 3], "counts": [1, 2, 3]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "must be a list of masks"),
        ([3], "mask 0 has no segmentation"),
        ([{"id": 1}], "mask 0 has no segmentation"),
        ([{"segmentation": RLE}], "mask 0 has no instance_id: SAM does not tell .* objgraph segment"),
        ([{"segmentation": RLE, "id": 0}], "mask 0: id 0 is none"),
        ([{"segmentation": RLE, "id": "chair"}], "mask 0: id 'chair' is none"),
        ([{"segmentation": {"size": [2, 3]}, "id": 1}], "mask 0: its segmentation is damaged .*counts"),
        ([{"segmentation": {"size": [2, 3], "counts": [1, 2]}, "id": 1}], "the runs do not fill 3x2 pixels"),
        ([{"segmentation": {"size": [2, 3], "counts": [7, -1]}, "id": 1}], "the runs do not fill"),
        ([{"segmentation": {"size": [2, 3], "counts": "12`"}, "id": 1}], "the runs are cut off"),
        ([{"segmentation": {"size": [2, 3], "counts": "1 3"}, "id": 1}], "' ' in the runs"),
        ([{"segmentation": {"size": [10**6, 10**6], "counts": [10**12]}, "id": 1}], "1000000x1000000 pixels"),
        ([{"segmentation": [[1, 2, 3, 4]], "id": 1}], "three corners or more"),
        ([{"segmentation": [], "id": 1}], "three corners or more"),
        (
            [{"segmentation": [[9, 9, 190, 9, 190, 30]], "id": 1}],
            r"outside of \d+x\d+ pixels: scale polygons",
        ),
        ([{"segmentation": [[9, 9, 20, -9, 20, 20]], "id": 1}], "a corner lies outside"),
        ([{"segmentation": [RLE], "id": 1}], "is damaged"),
        (
            [{"segmentation": RLE, "id": 1}, {"segmentation": {"size": [3, 2], "counts": [6]}, "id": 2}],
            "masks are of several sizes",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path, content, message):
    path = written(tmp_path / "000001.json", content)
    with pytest.raises(DatasetError, match=message) as caught:
        read_mask_json(path, SHAPE)
    assert str(path) in str(caught.value)


anything = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.sampled_from(["size", "counts"]), inner),
    max_leaves=12,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(anything)
def test_any_segmentation_is_read_or_refused(tmp_path, segmentation):
    path = written(tmp_path / "m.json", [{"segmentation": segmentation, "id": 1}])
    try:
        named = str(path) if read_mask_json(path, SHAPE).ndim == 2 else ""
    except DatasetError as error:
        named = str(error)
    assert str(path) in named
