import gtsam
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from factors.errors import FactorError
from factors.sdf import MetricSdf
from factors.state import ObjectKeys, ObjectState
from tests.factors.conftest import CODE_LENGTH, random_state


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-9, 1.0, np.pi - 1e-6, np.pi]))
def test_values_round_trip_and_points_round_trip(seed, angle):
    rng = np.random.default_rng(seed)
    state, keys, values = random_state(rng, angle), ObjectKeys.numbered(seed % 100), gtsam.Values()
    state.insert(values, keys)
    back = ObjectState.from_values(values, keys)
    assert back.T_world_object.equals(state.T_world_object, 1e-12)
    np.testing.assert_array_equal(back.log_scale, state.log_scale)
    np.testing.assert_array_equal(back.code, state.code)
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose(state.to_world(state.to_object(points)), points, atol=1e-12)
    homogeneous = np.c_[points, np.ones(5)] @ state.matrix.T
    np.testing.assert_allclose(homogeneous[:, :3], state.to_world(points), atol=1e-12)


def test_local_coordinates_lead_to_the_other_state():
    one = ObjectState(
        gtsam.Pose3(gtsam.Rot3.Rodrigues(0.3, -1.0, 0.4), np.array([1.0, 2, 3])), np.zeros(3), np.ones(4)
    )
    for angle in (0.0, 1.5, np.pi):
        turn = gtsam.Pose3(gtsam.Rot3.Ry(angle), np.array([0.1, -0.2, 0.3]))
        other = ObjectState(one.T_world_object.compose(turn), np.array([0.1, 0.2, -0.4]), np.arange(4.0))
        found = one.retract(one.local_coordinates(other))
        assert found.T_world_object.equals(other.T_world_object, 1e-9)
        np.testing.assert_allclose(found.log_scale, other.log_scale, atol=1e-12)
        np.testing.assert_allclose(found.code, other.code, atol=1e-12)
    np.testing.assert_allclose(one.local_coordinates(one), np.zeros(13), atol=1e-12)


def test_retract_is_gtsams(keys):
    rng = np.random.default_rng(0)
    state, delta = random_state(rng), rng.normal(size=9 + CODE_LENGTH)
    values, moved = gtsam.Values(), gtsam.VectorValues()
    state.insert(values, keys)
    for key, part in zip(keys, np.split(delta, [6, 9]), strict=True):
        moved.insert(key, part)
    expected = ObjectState.from_values(values.retract(moved), keys)
    actual = state.retract(delta)
    assert actual.T_world_object.equals(expected.T_world_object, 1e-12)
    np.testing.assert_allclose(actual.log_scale, expected.log_scale)
    np.testing.assert_allclose(actual.code, expected.code)


def test_taken_keys_are_named(keys):
    values, state = gtsam.Values(), random_state(np.random.default_rng(2))
    state.insert(values, keys)
    with pytest.raises(FactorError, match="o0"):
        state.insert(values, keys)


@pytest.mark.parametrize("dtype", [np.int64, np.uint8, np.float32])
def test_numbers_of_another_kind_are_those_of_double_precision(dtype):
    one, other = (
        ObjectState(gtsam.Pose3(), np.full(3, log_scale, dtype), np.full(4, log_scale, dtype))
        for log_scale in (1, 0)
    )
    np.testing.assert_array_equal(one.local_coordinates(other), [*np.zeros(6), *np.full(7, -1.0)])
    np.testing.assert_array_equal(one.scale, np.full(3, np.e))
    metric = MetricSdf.of(torch.eye(3), one)
    np.testing.assert_allclose(metric.at(other), 1.0, rtol=1e-6)


def test_values_of_another_shape_are_named_by_their_keys(keys):
    values = gtsam.Values()
    values.insert(keys.pose, gtsam.Pose3())
    values.insert(keys.log_scale, np.zeros(2))
    values.insert(keys.code, np.zeros(CODE_LENGTH))
    with pytest.raises(FactorError, match=r"no object at o0, s0, z0: .*log_scale has shape \(2,\)"):
        ObjectState.from_values(values, keys)
