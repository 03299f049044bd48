"""Points through transforms against GTSAM and back, and cameras that look at something."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.geometry.transforms import look_at, transform_points, transform_points_back

triples = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
poses = st.builds(lambda w, t: gtsam.Pose3(gtsam.Rot3.Expmap(w), t), triples, triples)
points = st.lists(triples, min_size=1, max_size=6).map(np.array)


@given(poses, points)
def test_points_go_where_gtsam_takes_them(T_a_b, p_b):
    p_a = transform_points(T_a_b.matrix(), p_b)
    np.testing.assert_allclose(p_a, [T_a_b.transformFrom(p) for p in p_b], atol=1e-12)
    np.testing.assert_allclose(transform_points(T_a_b.inverse().matrix(), p_a), p_b, atol=1e-12)


@given(poses, points)
def test_there_and_back(T_a_b, p):
    np.testing.assert_allclose(
        transform_points_back(T_a_b.matrix(), transform_points(T_a_b.matrix(), p)), p, atol=1e-12
    )


def test_no_points_stay_none():
    assert transform_points(np.eye(4), np.zeros((0, 3))).shape == (0, 3)
    assert transform_points_back(np.eye(4), np.zeros((0, 3))).shape == (0, 3)


@given(triples, triples, triples)
def test_a_camera_has_what_it_looks_at_on_its_axis(eye, target, up):
    distance, length = np.linalg.norm(target - eye), np.linalg.norm(up)
    if distance < 1e-2 or length < 1e-2:
        return
    T_world_camera = look_at(eye, target, up / length)
    np.testing.assert_allclose(T_world_camera[:3, :3].T @ T_world_camera[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(T_world_camera[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_array_equal(T_world_camera[:3, 3], eye)
    p_camera = transform_points_back(T_world_camera, np.stack([target, eye + up]))
    np.testing.assert_allclose(p_camera[0], [0.0, 0.0, distance], atol=1e-12)
    assert p_camera[1, 1] < 1e-5  # what is above is not below the middle of the picture
