"""Intersection over union of oriented boxes: closed form, Monte Carlo, invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph.errors import GeometryError
from objgraph.geometry.boxes import OrientedBox, box_iou, intersection_volume

numbers = st.floats(-2.0, 2.0, allow_nan=False)
lengths = st.floats(0.05, 3.0)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
extents = st.tuples(lengths, lengths, lengths).map(np.array)
rotations = vectors.map(lambda v: Rotation.from_rotvec(2 * v).as_matrix())
boxes = st.builds(OrientedBox, vectors, rotations, extents)


@settings(max_examples=60, deadline=None)
@given(vectors, extents, vectors, extents)
def test_aligned_boxes_have_the_closed_form(a_centre, a_extents, b_centre, b_extents):
    a, b = OrientedBox(a_centre, np.eye(3), a_extents), OrientedBox(b_centre, np.eye(3), b_extents)
    low = np.maximum(a_centre - a_extents / 2, b_centre - b_extents / 2)
    high = np.minimum(a_centre + a_extents / 2, b_centre + b_extents / 2)
    shared = np.prod(np.clip(high - low, 0, None))
    assert intersection_volume(a, b) == pytest.approx(shared, rel=1e-6, abs=1e-7)
    assert box_iou(a, b) == pytest.approx(shared / (a.volume + b.volume - shared), rel=1e-6, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(boxes, boxes)
def test_any_boxes_agree_with_monte_carlo(a, b):
    p_a = np.random.default_rng(0).uniform(-0.5, 0.5, (20_000, 3)) * a.extents
    share = b.contains(p_a @ a.rotation.T + a.centre).mean()
    # five standard deviations of the share's estimate
    assert intersection_volume(a, b) / a.volume == pytest.approx(share, abs=5 * 0.5 / np.sqrt(20_000))


@settings(max_examples=40, deadline=None)
@given(boxes, boxes, rotations, vectors)
def test_a_common_motion_and_the_order_change_nothing(a, b, R, t):
    moved = [OrientedBox(R @ box.centre + t, R @ box.rotation, box.extents) for box in (a, b)]
    assert box_iou(*moved) == pytest.approx(box_iou(a, b), abs=1e-6)
    assert box_iou(b, a) == pytest.approx(box_iou(a, b), abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(boxes)
def test_a_box_with_itself_is_one(box):
    assert box_iou(box, box) == pytest.approx(1.0, abs=1e-9)


def test_a_cube_turned_by_an_eighth_about_y():
    a = OrientedBox(np.zeros(3), np.eye(3), np.ones(3))
    b = OrientedBox(np.zeros(3), Rotation.from_rotvec([0, np.pi / 4, 0]).as_matrix(), np.ones(3))
    octagon = 2 * (np.sqrt(2) - 1)
    assert box_iou(a, b) == pytest.approx(octagon / (2 - octagon), rel=1e-9)


@pytest.mark.parametrize("distance", [1.0, 1.0 + 1e-12, 1.5, 100.0])
def test_boxes_that_touch_or_are_apart_share_nothing(distance):
    a = OrientedBox(np.zeros(3), np.eye(3), np.ones(3))
    b = OrientedBox(np.array([distance, 0, 0]), np.eye(3), np.ones(3))
    assert box_iou(a, b) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(100))
def test_boxes_that_overlap_at_a_corner_by_next_to_nothing_share_nothing(seed):
    rng = np.random.default_rng(seed)
    extents, overlap = rng.uniform(0.3, 2, 3), 10 ** rng.uniform(-9, -6, 3)
    a = OrientedBox(np.zeros(3), np.eye(3), np.ones(3))
    b = OrientedBox((np.ones(3) + extents) / 2 - overlap, np.eye(3), extents)
    assert intersection_volume(a, b) == pytest.approx(0.0, abs=1e-15)


def test_a_flat_box_is_refused():
    with pytest.raises(GeometryError, match="positive side lengths"):
        OrientedBox(np.zeros(3), np.eye(3), np.array([1.0, 0.0, 1.0]))


@given(boxes)
def test_the_box_about_a_boxs_corners_is_that_box(box):
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    again = OrientedBox.about(box.centre + (signs * box.extents) @ box.rotation.T, box.rotation)
    np.testing.assert_allclose(again.centre, box.centre, atol=1e-12)
    np.testing.assert_allclose(again.extents, box.extents, atol=1e-12)
