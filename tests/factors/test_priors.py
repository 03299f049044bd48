import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.errors import FactorError
from factors.priors import (
    code_prior,
    placed_prior,
    scale_covariance,
    scale_prior,
    sized_prior,
    upright_prior,
)
from factors.state import ObjectKeys, ObjectState

KEYS = ObjectKeys.numbered(1)


def test_scale_covariance_separates_size_from_shape():
    covariance = scale_covariance(0.3, 0.05)
    samples = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, size=200_000)
    mean = samples.mean(axis=1)
    assert mean.std() == pytest.approx(0.3, rel=0.01)
    across = samples - mean[:, None]
    assert np.sqrt((across**2).sum(axis=1).mean() / 2) == pytest.approx(0.05, rel=0.01)
    assert abs(np.mean(mean * across[:, 0])) < 1e-4


def test_priors_are_half_squared_mahalanobis_distances():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(4, 4))
    covariance, code, mean = root @ root.T + np.eye(4), rng.normal(size=4), rng.normal(size=4)
    state = ObjectState(gtsam.Pose3(), np.array([0.1, 0.2, 0.4]), code)
    values = gtsam.Values()
    state.insert(values, KEYS)
    expected = 0.5 * (code - mean) @ np.linalg.solve(covariance, code - mean)
    assert code_prior(KEYS, mean, covariance).error(values) == pytest.approx(expected)
    off = state.log_scale - 0.15
    expected = 0.5 * off @ np.linalg.solve(scale_covariance(0.3, 0.05), off)
    assert scale_prior(KEYS, 0.15, 0.3, 0.05).error(values) == pytest.approx(expected)


@given(st.integers(0, 10**6), st.integers(2, 12), st.floats(0, 12))
def test_a_prior_of_codes_is_exact_however_unequal_their_variances_are(seed, length, decades):
    """What collapsed when the codes were trained hardly varies; its directions are not the code's axes."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(length, length)))
    variance = 10.0 ** -np.linspace(0, decades, length)
    whitened = rng.normal(size=length)
    values = gtsam.Values()
    values.insert(KEYS.code, axes @ (np.sqrt(variance) * whitened))
    prior = code_prior(KEYS, np.zeros(length), (axes * variance) @ axes.T)
    assert prior.error(values) == pytest.approx(0.5 * whitened @ whitened, rel=1e-2)
    information = prior.linearize(values).information()
    back = axes.T @ information @ axes * np.sqrt(np.outer(variance, variance))
    np.testing.assert_allclose(back, np.eye(length), atol=1e-2)


@pytest.mark.parametrize("anisotropy_sigma", [1e-1, 1e-4, 1e-6])
def test_scales_that_hardly_differ_count_as_they_should(anisotropy_sigma):
    values, across = gtsam.Values(), np.array([1.0, -2.0, 1.0]) / np.sqrt(6)
    values.insert(KEYS.log_scale, 0.3 + anisotropy_sigma * across)
    assert scale_prior(KEYS, 0.0, 0.3, anisotropy_sigma).error(values) == pytest.approx(1.0, rel=1e-3)


def test_scales_that_differ_by_less_than_can_be_told_are_refused():
    with pytest.raises(FactorError, match=r"size_sigma and anisotropy_sigma, is not positive definite"):
        scale_prior(KEYS, 0.0, 1.0, 1e-9)


@pytest.mark.parametrize("tilt", [0.0, 0.02, 0.1])
def test_upright_prior_measures_the_tilt_and_not_the_heading(tilt):
    up = np.array([0.0, 0.0, 1.0])
    y_up = gtsam.Rot3.Rx(np.pi / 2)  # +y of the object to +z of the world
    for heading in (0.0, 2.0):
        rotation = gtsam.Rot3.Rz(heading).compose(gtsam.Rot3.Rx(tilt)).compose(y_up)
        values = gtsam.Values()
        ObjectState(gtsam.Pose3(rotation, np.zeros(3)), np.zeros(3), np.zeros(2)).insert(values, KEYS)
        error = upright_prior(KEYS, up, 0.05).error(values)
        assert error == pytest.approx(0.5 * (np.sin(tilt) / 0.05) ** 2, rel=0.01, abs=1e-9)
        assert error == pytest.approx(0.5 * (2 * np.sin(tilt / 2) / 0.05) ** 2, rel=1e-9, abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_upright_prior_says_nothing_of_a_turn_about_up_however_much_an_object_leans(seed):
    rng = np.random.default_rng(seed)
    T, up = gtsam.Pose3(gtsam.Rot3.Expmap(2 * rng.normal(size=3)), rng.normal(size=3)), rng.normal(size=3)
    values = gtsam.Values()
    values.insert(KEYS.pose, T)
    rows, _ = upright_prior(KEYS, up, 0.05).linearize(values).jacobian()
    R = T.rotation().matrix()
    turn = np.concatenate([R.T @ up, R.T @ np.cross(up, T.translation())]) / np.linalg.norm(up)
    np.testing.assert_allclose(rows @ turn, 0, atol=1e-12 / 0.05)


@pytest.mark.parametrize("lean_deg", [20.0, 65.0, 100.0, 150.0, 175.0])
def test_what_leans_is_righted(lean_deg):
    up = np.array([0.0, 0.0, 1.0])
    rotation = gtsam.Rot3.Rx(np.radians(lean_deg)).compose(gtsam.Rot3.Rx(np.pi / 2))
    values = gtsam.Values()
    ObjectState(gtsam.Pose3(rotation, np.zeros(3)), np.zeros(3), np.zeros(2)).insert(values, KEYS)
    loosely = gtsam.noiseModel.Isotropic.Sigma(6, 1.0)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(upright_prior(KEYS, up, 0.05))
    graph.push_back(gtsam.PriorFactorPose3(KEYS.pose, values.atPose3(KEYS.pose), loosely))
    found = gtsam.Values()
    found.insert(KEYS.pose, values.atPose3(KEYS.pose))
    found = gtsam.LevenbergMarquardtOptimizer(graph, found).optimize()
    assert found.atPose3(KEYS.pose).rotation().matrix()[:, 1] @ up > 0.99


def test_a_detectors_box_is_a_measurement_along_the_objects_own_axes():
    detected = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.5, 1.1), np.array([4.0, -2.0, 20.0]))
    place = placed_prior(KEYS, detected, heading_sigma=0.1, lean_sigma=0.4, position_sigma=0.3)
    size = sized_prior(KEYS, np.array([0.1, 0.2, 0.3]), 0.08)
    for axis, sigma in enumerate((0.4, 0.1, 0.4, 0.3, 0.3, 0.3)):  # the second is about the up axis
        off = np.zeros(6)
        off[axis] = 0.05
        values = gtsam.Values()
        state = ObjectState(detected.retract(off), np.array([0.1, 0.2, 0.34]), np.zeros(2))
        state.insert(values, KEYS)
        assert place.error(values) == pytest.approx(0.5 * (0.05 / sigma) ** 2, rel=1e-6)
        assert size.error(values) == pytest.approx(0.5 * (0.04 / 0.08) ** 2)
