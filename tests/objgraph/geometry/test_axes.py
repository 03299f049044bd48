"""Axes across others: orthonormal, right-handed, and where they are said to point."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph.geometry.axes import camera_axes, farthest_axis, level_axes, perpendicular, upright_axes

vectors = st.tuples(*[st.floats(-5.0, 5.0)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)
units = vectors.map(lambda v: v / np.linalg.norm(v))
headings = st.floats(-7.0, 7.0)


def assert_rotation(R) -> None:
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(vectors)
def test_the_perpendicular_is_a_unit_vector_across(direction):
    across = perpendicular(direction)
    assert np.linalg.norm(across) == pytest.approx(1.0)
    assert across @ direction == pytest.approx(0.0, abs=1e-12)
    assert farthest_axis(direction) @ across == pytest.approx(0.0, abs=1e-12)


@given(units)
def test_no_coordinate_axis_lies_farther_across(direction):
    assert abs(farthest_axis(direction) @ direction) == np.abs(direction).min()


@given(units)
def test_level_axes_and_up_are_right_handed(up):
    assert_rotation(np.stack([*level_axes(up), up], axis=1))


@given(vectors, headings)
def test_upright_axes_stand_at_their_heading(up, heading):
    R = upright_axes(up, heading)
    assert_rotation(R)
    np.testing.assert_allclose(R[:, 1], up / np.linalg.norm(up), atol=1e-12)
    turned = Rotation.from_rotvec(heading * R[:, 1]).as_matrix() @ upright_axes(up, 0.0)
    np.testing.assert_allclose(R, turned, atol=1e-12)


@given(units, units)
def test_a_camera_is_level_and_looks_ahead(forward, up):
    R = camera_axes(forward, up)
    assert_rotation(R)
    np.testing.assert_array_equal(R[:, 2], forward)
    assert R[:, 0] @ up == pytest.approx(0.0, abs=2e-6)
    assert R[:, 1] @ up < 2e-6


@given(units, st.sampled_from([-1.0, 1.0]))
def test_a_camera_may_look_straight_up_and_down(up, sign):
    assert_rotation(camera_axes(sign * up, up))
