"""Which detection is which label."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from objgraph.bench.comparison.boxes.matching import LabelledBox, heading_between_deg, matches
from objgraph.observation.lidar.frame import Detection
from objgraph.observation.lidar.kitti_box import KittiBox


def box(x: float, z: float = 10.0, yaw: float = 0.0) -> KittiBox:
    return KittiBox("Car", 0.0, 0, np.zeros(4), 1.5, 1.6, 3.9, np.array([x, 1.6, z]), yaw, None)


def detection(number: int, *place: float, category: str = "car") -> Detection:
    return Detection(number, category, box(*place).T_rect_object, np.ones(3))


def label(number: int, *place: float) -> LabelledBox:
    return LabelledBox(number, "car", box(*place).T_rect_object, np.ones(3))


def test_near_and_alike_is_the_same():
    found = matches([detection(7, 0.3)], [label(1, 2.0), label(2, 0.0)])
    assert {key: each.number for key, each in found.items()} == {7: 2}


def test_the_papers_filter():
    assert not matches([detection(1, 1.1)], [label(1, 0.0)])
    assert matches([detection(1, 0.9)], [label(1, 0.0)])
    assert not matches([detection(1, 0, 10, np.radians(21))], [label(1, 0, 10, 0)])
    assert matches([detection(1, 0, 10, np.radians(19))], [label(1, 0, 10, 0)])
    assert not matches([detection(1, 0, 10, np.pi)], [label(1, 0, 10, 0)])  # it faces backwards
    assert not matches([detection(1, 0.0, category="van")], [label(1, 0.0)])
    assert not matches([], [label(1, 0.0)])
    assert not matches([detection(1, 0.0)], [])


def test_a_label_is_given_once_and_as_many_as_can_be_find_one():
    # the nearest of both is label 1; one of them must take the other
    found = matches([detection(1, 0.0), detection(2, 0.4)], [label(1, 0.2), label(2, 1.2)])
    assert {key: each.number for key, each in found.items()} == {1: 1, 2: 2}


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_the_angle_between_headings(a, b):
    expected = np.degrees(abs((a - b + np.pi) % (2 * np.pi) - np.pi))
    found = heading_between_deg(box(0, 10, a).T_rect_object, box(1, 20, b).T_rect_object)
    assert abs(found - expected) < 1e-4
