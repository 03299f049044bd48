from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from factors.sdf import MetricSdf, metres_per_unit, propagated_variance, query_points, sdf_jacobian
from factors.state import ObjectState
from tests.factors.conftest import CODE_LENGTH, SphereDecoder, make_decoder, random_camera, random_state

STEP = 1e-6


def numerical_jacobian(function, state: ObjectState, camera: gtsam.Pose3, dof: int) -> np.ndarray:
    """Central differences of `function(state, camera)` along both retractions."""
    columns = []
    for i in range(dof):
        sides = []
        for sign in (1, -1):
            delta = np.zeros(dof)
            delta[i] = sign * STEP
            moved_camera = camera.retract(delta[-6:]) if dof > 9 + CODE_LENGTH else camera
            sides.append(function(state.retract(delta[: 9 + CODE_LENGTH]), moved_camera))
        columns.append((sides[0] - sides[1]) / (2 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1.0, np.pi - 1e-7, np.pi])
@pytest.mark.parametrize("camera_is_variable", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_sdf_jacobian(angle, camera_is_variable, seed):
    rng = np.random.default_rng(seed)
    decoder, state, camera = make_decoder(seed), random_state(rng, angle), random_camera(rng)
    points = rng.normal(size=(20, 3)) * 0.3 + [0, 0, 2.5]

    def value(state, camera):
        query = query_points(decoder, state, camera, points)
        return decoder(query.p_object, query.code[None]).detach().numpy()

    query = query_points(decoder, state, camera, points)
    jet = decoder.linearize(query.p_object, query.code[None])
    analytic = sdf_jacobian(query, jet, camera_is_variable).numpy()
    numeric = numerical_jacobian(value, state, camera, analytic.shape[1])
    assert np.abs(analytic - numeric).max() < 1e-5 * np.abs(numeric).max()


@pytest.mark.parametrize("slope", [0.1, 0.5, 0.8, 1.0, 1.7, 2.0, 5.0])
def test_metres_of_a_unit_are_those_along_the_normal_of_a_stretched_field(slope):
    """One over the metric gradient; a decoder's slope is taken for no less than half and no more than two."""
    rng = np.random.default_rng(0)
    state = ObjectState(gtsam.Pose3(), rng.uniform(-1, 1, 3), np.zeros(CODE_LENGTH))
    normal = rng.normal(size=(20, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = metres_per_unit(torch.as_tensor(slope * normal), state)
    gradient = np.clip(slope, 0.5, 2.0) * normal / state.scale
    np.testing.assert_allclose(found, 1 / np.linalg.norm(gradient, axis=1))


def test_where_a_decoder_is_flat_a_unit_is_no_more_than_twice_the_mean_of_the_axes():
    """A distance that is cut off has no slope: its direction is none, and its length counts as the least."""
    state = ObjectState(gtsam.Pose3(), np.log([1.0, 2.0, 4.0]), np.zeros(CODE_LENGTH))
    d_point = torch.tensor([[0.0, 0.0, 0.0], [1e-30, 0.0, 0.0]], dtype=torch.float64)
    np.testing.assert_allclose(metres_per_unit(d_point, state), [4.0, 2.0])


def test_metres_of_a_scaled_sphere_are_metres():
    decoder, state = (
        SphereDecoder(),
        ObjectState(gtsam.Pose3(), np.log([2.0, 2.0, 2.0]), np.zeros(CODE_LENGTH)),
    )
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    query = query_points(decoder, state, gtsam.Pose3(), 0.9 * directions)
    jet = decoder.linearize(query.p_object, query.code[None])
    metric = metres_per_unit(jet.d_point, state) * jet.value
    np.testing.assert_allclose(metric, 0.1, atol=1e-12)


def test_metres_follow_the_scale():
    """Frozen with the decoder's gradient, they are those of any other scale, and so is the metric derivative."""
    rng = np.random.default_rng(5)
    decoder, state, camera = make_decoder(4), random_state(rng), random_camera(rng)
    points = rng.normal(size=(40, 3)) * 0.2 + [0, 0, 2.5]
    query = query_points(decoder, state, camera, points)
    jet = decoder.linearize(query.p_object, query.code[None])
    frozen = MetricSdf.of(jet.d_point, state)
    torch.testing.assert_close(frozen.at(state), metres_per_unit(jet.d_point, state))
    moved = replace(state, log_scale=state.log_scale + [0.02, -0.01, 0.015])
    anew = metres_per_unit(jet.d_point, moved)
    assert (anew / frozen.metres - 1).abs().max() > 0.01
    torch.testing.assert_close(frozen.at(moved), anew, rtol=5e-4, atol=0)

    def metric(state, camera):
        query = query_points(decoder, state, camera, points)
        return (frozen.at(state) * decoder(query.p_object, query.code[None])).detach().numpy()

    analytic = frozen.jacobian(state, jet.value, sdf_jacobian(query, jet, camera=True)).numpy()
    numeric = numerical_jacobian(metric, state, camera, analytic.shape[1])
    assert np.abs(analytic - numeric).max() < 1e-5 * np.abs(numeric).max()


@given(
    st.lists(st.floats(-2, 2), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    st.sampled_from([0.0, 1e-30, 1e-15, 0.3, 1.0, 5.0]),
)
def test_metres_have_the_derivative_of_their_scale_however_flat_the_decoder_is(log_scale, by, slope):
    state = ObjectState(gtsam.Pose3(), np.array(log_scale), np.zeros(CODE_LENGTH))
    d_point = slope * torch.tensor([[1.0, 2.0, -2.0], [0.0, 1.0, 0.0]], dtype=torch.float64) / 3
    frozen = MetricSdf.of(d_point, state)

    def refrozen(step: float) -> torch.Tensor:
        moved = replace(state, log_scale=state.log_scale + step * np.array(by))
        return MetricSdf.of(d_point, moved).metres.log()

    slopes = (refrozen(1e-5) - refrozen(-1e-5)) / 2e-5
    np.testing.assert_allclose(frozen.share @ torch.tensor(by, dtype=torch.float64), slopes, atol=1e-8)
    grown = replace(state, log_scale=state.log_scale + 0.7)
    np.testing.assert_allclose(frozen.at(grown), MetricSdf.of(d_point, grown).metres)


def test_growing_an_object_and_shrinking_its_shape_leaves_residuals_as_they_are():
    decoder, points, residuals = SphereDecoder(), 0.44 * np.eye(3), []
    start = ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(CODE_LENGTH))
    query = query_points(decoder, start, gtsam.Pose3(), points)
    frozen = MetricSdf.of(decoder.linearize(query.p_object, query.code[None]).d_point, start)
    for growth in (1.0, 1.2):
        code = np.array([0.4 / growth - 0.4, *np.zeros(CODE_LENGTH - 1)])
        query = query_points(
            decoder, replace(start, log_scale=np.full(3, np.log(growth)), code=code), gtsam.Pose3(), points
        )
        residuals.append(frozen.at(query.state) * decoder(query.p_object, query.code[None]))
    torch.testing.assert_close(residuals[1], residuals[0])
    torch.testing.assert_close(residuals[0], torch.full((3,), 0.04, dtype=torch.float64))


def test_propagated_variance_is_that_of_sampled_states():
    rng = np.random.default_rng(3)
    decoder, state, camera = make_decoder(3), random_state(rng), random_camera(rng)
    points = rng.normal(size=(4, 3)) * 0.2 + [0, 0, 2.5]
    factor = rng.normal(size=(9 + CODE_LENGTH,) * 2) * 1e-4
    covariance = factor @ factor.T

    def value(state):
        query = query_points(decoder, state, camera, points)
        return decoder(query.p_object, query.code[None]).detach().numpy()

    query = query_points(decoder, state, camera, points)
    jacobian = sdf_jacobian(query, decoder.linearize(query.p_object, query.code[None]), camera=False)
    variance = propagated_variance(jacobian, torch.as_tensor(covariance))
    sampled = np.var(
        [value(state.retract(factor @ rng.normal(size=len(factor)))) for _ in range(4000)], axis=0
    )
    np.testing.assert_allclose(variance, sampled, rtol=0.1)
    diagonal = torch.as_tensor(np.diag(covariance).copy())
    torch.testing.assert_close(
        propagated_variance(jacobian, diagonal), propagated_variance(jacobian, torch.diag(diagonal))
    )
