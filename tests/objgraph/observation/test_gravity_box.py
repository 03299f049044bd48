"""Boxes about gravity, in any world."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.observation.gravity_box import gravity_box, smallest_heading

UP = np.array([0.0, 0.0, 1.0])
SIZE = np.array([0.9, 0.4, 1.3])
"""Of a made-up cuboid: level, level, up."""

ups = st.sampled_from([(0, 0, 1), (0, -1, 0), (0, 1, 0), (1, 0, 0), (0, 0, -2), (0.3, -0.8, 0.5)])
angles = st.floats(-np.pi, np.pi)


def cuboid(count: int = 4000) -> np.ndarray:
    """Points that fill a cuboid about the origin."""
    return np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3)) * SIZE


def turned(points: np.ndarray, up, angle: float) -> np.ndarray:
    """A z-up world's points in a world of another up, turned about it."""
    up = np.asarray(up, float) / np.linalg.norm(up)
    axis = np.cross(UP, up)
    if np.linalg.norm(axis) > 1e-9:
        axis /= np.linalg.norm(axis)
    else:
        axis = np.array([1.0, 0.0, 0.0])
    onto = gtsam.Rot3.AxisAngle(axis, float(np.arccos(np.clip(UP @ up, -1, 1))))
    return points @ (gtsam.Rot3.AxisAngle(up, angle).matrix() @ onto.matrix()).T


def modulo(angle: float, period: float) -> float:
    """Distance of an angle from the next multiple of the period."""
    return float(np.abs((angle + period / 2) % period - period / 2))


@settings(max_examples=30)
@given(ups, angles)
def test_the_smallest_heading_turns_with_the_points(up, angle):
    start = smallest_heading(turned(cuboid(), up, 0.0), np.array(up, float))
    after = smallest_heading(turned(cuboid(), up, angle), np.array(up, float))
    assert modulo(after - start - angle, np.pi / 2) < np.radians(4)


@settings(max_examples=30)
@given(angles, st.sampled_from([(300, -450), (2e4, -3e4), (5e5, 4e5), (-9e5, 9e5)]))
def test_the_smallest_heading_is_the_same_wherever_the_world_begins(angle, place):
    """In maps of surveyed coordinates it was off by ten degrees."""
    points = turned(cuboid(600), UP, angle)
    found = smallest_heading(points + [*place, 0.0], UP)
    assert modulo(found - smallest_heading(points, UP), np.pi / 2) < np.radians(1e-3)


@settings(max_examples=30)
@given(ups, angles, st.tuples(*[st.floats(-5, 5)] * 3))
def test_the_box_at_the_smallest_heading_is_the_cuboid(up, angle, offset):
    points = turned(cuboid(), up, angle) + np.array(offset)
    up = np.array(up, float)
    box = gravity_box(points, up, smallest_heading(points, up))
    np.testing.assert_allclose(box.R_world_object @ box.R_world_object.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(box.R_world_object) == pytest.approx(1)
    np.testing.assert_allclose(box.R_world_object[:, 1], up / np.linalg.norm(up), atol=1e-12)
    np.testing.assert_allclose(np.sort(box.size[[0, 2]]), np.sort(SIZE[:2]), rtol=0.06)
    assert box.size[1] == pytest.approx(SIZE[2], rel=0.04)
    np.testing.assert_allclose(box.centre_world, offset, atol=0.03)


@settings(max_examples=30)
@given(ups, angles, angles)
def test_any_heading_s_box_holds_the_points(up, angle, heading):
    points, up = turned(cuboid(), up, angle), np.array(up, float)
    box = gravity_box(points, up, heading)
    inside = np.abs((points - box.centre_world) @ box.R_world_object) <= 0.5 * box.size + 1e-9
    assert inside.all(axis=1).mean() > 0.93
    again = gravity_box(points, up, heading + 2 * np.pi)
    np.testing.assert_allclose(again.R_world_object, box.R_world_object, atol=1e-9)


@settings(max_examples=30)
@given(ups, angles, st.floats(0.0, 0.75), st.floats(-5, 5))
def test_the_box_stands_on_a_near_floor(up, heading, gap, height):
    up = np.array(up, float) / np.linalg.norm(up)
    points = turned(cuboid(), up, 0.0) + height * up
    seen = gravity_box(points, up, heading)
    bottom = seen.centre_world @ up - 0.5 * seen.size[1]
    floor = float(bottom - gap)
    box = gravity_box(points, up, heading, floor, floor_reach=0.8)
    assert box.centre_world @ up - 0.5 * box.size[1] == pytest.approx(floor, abs=1e-9)
    assert box.centre_world @ up + 0.5 * box.size[1] == pytest.approx(bottom + seen.size[1], abs=1e-9)
    np.testing.assert_allclose(box.size[[0, 2]], seen.size[[0, 2]])
    far = gravity_box(points, up, heading, floor, floor_reach=gap - 1e-3)
    np.testing.assert_allclose(far.size, seen.size)
    np.testing.assert_allclose(far.centre_world, seen.centre_world)


def test_stray_points_do_not_move_the_box():
    points = np.concatenate([cuboid(), np.random.default_rng(1).uniform(-9, 9, (15, 3))])
    box = gravity_box(points, UP, smallest_heading(points, UP))
    np.testing.assert_allclose(np.sort(box.size), np.sort(SIZE), rtol=0.08)


def test_a_flat_cloud_has_a_box_all_the_same():
    box = gravity_box(cuboid() * [1, 0, 1], UP, 0.0)
    assert (box.size >= 0.05).all()
