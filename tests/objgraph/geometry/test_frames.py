"""Axes are right-handed and orthonormal, cameras look where they should, points come back."""

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from objgraph.geometry.frames import (
    level_axes,
    look_at,
    perpendicular,
    transformed,
    transformed_back,
    upright_axes,
    why_not_rigid,
)

VECTOR = hnp.arrays(float, 3, elements=st.floats(-5, 5).map(lambda x: round(x, 6)))


def unit(v: np.ndarray) -> np.ndarray:
    assume(np.linalg.norm(v) > 0.1)
    return v / np.linalg.norm(v)


def assert_rotation(R: np.ndarray) -> None:
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(VECTOR, st.floats(-10, 10))
def test_axes_are_right_handed(direction, heading):
    up = unit(direction)
    assert abs(perpendicular(up) @ up) < 1e-12
    assert np.linalg.norm(perpendicular(up)) > 0.5  # never nearly along it
    assert_rotation(np.stack([*level_axes(up), up], axis=1))
    R = upright_axes(3.0 * up, heading)
    assert_rotation(R)
    np.testing.assert_allclose(R[:, 1], up, atol=1e-12)
    turned = upright_axes(up, heading + 0.3)
    assert turned[:, 0] @ R[:, 0] == pytest.approx(np.cos(0.3))


@given(VECTOR, VECTOR, VECTOR)
def test_a_camera_sees_its_target_in_the_middle_and_up_above(eye, target, up):
    up = unit(up)
    assume(np.linalg.norm(target - eye) > 0.1)
    T = look_at(eye, target, up)
    assert_rotation(T[:3, :3])
    x, y, z = transformed_back(T, target[None])[0]
    assert z == pytest.approx(np.linalg.norm(target - eye))
    assert abs(x) + abs(y) < 1e-9
    assert T[:3, 1] @ up < 1e-9  # down is not up
    assert abs(T[:3, 0] @ up) < 1e-9 or np.linalg.norm(np.cross(unit(target - eye), up)) < 1e-6


@given(VECTOR, VECTOR, hnp.arrays(float, (4, 3), elements=st.floats(-9, 9)))
def test_points_come_back(eye, target, points):
    assume(np.linalg.norm(target - eye) > 0.1)
    T = look_at(eye, target, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(transformed_back(T, transformed(T, points)), points, atol=1e-9)
    homogeneous = np.concatenate([points, np.ones((4, 1))], axis=1) @ T.T
    np.testing.assert_allclose(transformed(T, points), homogeneous[:, :3], atol=1e-9)


@given(angle=st.floats(-3, 3), off=st.floats(-0.2, 0.2))
def test_a_rotation_that_is_stretched_is_told(angle: float, off: float):
    T = np.eye(4)
    T[:3, :3] = (1 + off) * upright_axes(np.array([0.0, 1.0, 0.0]), angle)
    assume(abs(abs((1 + off) ** 2 - 1) - 1e-2) > 1e-6)
    assert (why_not_rigid(T) is None) == (abs((1 + off) ** 2 - 1) < 1e-2)


@pytest.mark.parametrize(
    ("T", "why"),
    [
        (np.full((4, 4), np.nan), "it holds NaN or infinity"),
        (np.diag([1.0, 1, -1, 1]), "its rotation is a reflection"),
        (np.diag([1.0, 1, 1, 2]), "it is not rigid (R^T R is off by 0)"),
        (np.diag([2.0, 1, 1, 1]), "it is not rigid (R^T R is off by 3)"),
        (np.eye(4), None),
    ],
)
def test_it_is_said_what_is_wrong(T: np.ndarray, why: str | None):
    assert why_not_rigid(T) == why
