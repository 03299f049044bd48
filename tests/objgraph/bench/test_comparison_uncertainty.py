"""The correlation of error and uncertainty against closed forms, and its ingredients against numerical ones."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch

from factors.state import ObjectState
from objgraph.bench.comparison.objects.uncertainty import SurfaceErrors, gaussian_pearson, surface_errors
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.metrics.placed import PlacedMesh
from objgraph.metrics.shape import seen_points_on
from objgraph.priors.fallback import fallback_prior
from tests.toys import TOY_CODE, toy_mesh, toy_prior, toy_state

LENGTH = 9 + TOY_CODE


def truth_of(state: ObjectState) -> GroundTruth:
    mesh = toy_mesh(state.code)
    return GroundTruth(
        state.T_world_object.matrix(), state.scale, np.asarray(mesh.vertices), np.asarray(mesh.faces)
    )


def covariance(matrix: np.ndarray) -> ObjectCovariance:
    return ObjectCovariance.of(matrix, "test")


def gaussian(sigma: np.ndarray) -> SurfaceErrors:
    return SurfaceErrors(np.abs(np.random.default_rng(0).normal(size=len(sigma)) * sigma), sigma)


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: rng.uniform(0, 0.01, 200_000),
        lambda rng: rng.uniform(0.9, 1.1, 200_000),
        lambda rng: np.where(rng.uniform(size=200_000) < 0.02, 1.0, 1e-4),
    ],
)
def test_gaussian_errors_of_known_sigma_have_the_correlation_that_they_can_have(draw):
    sigma = draw(np.random.default_rng(1))
    expected = gaussian_pearson(sigma)
    assert expected is not None
    assert gaussian(sigma).pearson == pytest.approx(expected, abs=0.01)
    assert expected < 0.80


def test_equal_sigmas_tell_nothing():
    assert gaussian_pearson(np.full(100, 0.01)) is None
    assert gaussian_pearson(np.array([np.nan, 1.0])) is None


def test_widely_spread_sigmas_come_near_the_bound():
    sigma = np.where(np.arange(1_000_000) % 100 == 0, 1.0, 1e-4)
    assert gaussian(sigma).pearson == pytest.approx(np.sqrt(2 / np.pi), abs=0.02)


@pytest.mark.parametrize("sigma", [np.full(100, 0.01), np.full(100, 0.01) * (1 + 1e-13), np.zeros(100)])
def test_a_constant_sigma_has_no_correlation(sigma):
    errors = SurfaceErrors(np.random.default_rng(0).uniform(size=100), sigma)
    assert errors.pearson is None
    assert errors.spearman is None


def test_what_is_not_finite_has_no_correlation():
    errors = SurfaceErrors(np.array([0.1, np.nan, 0.2]), np.array([0.1, 0.2, 0.3]))
    assert errors.pearson is None


def test_ranks_are_correlated_beside_values():
    sigma = np.linspace(1, 2, 50)
    errors = SurfaceErrors(np.exp(8 * sigma), sigma)
    assert errors.spearman == pytest.approx(1)
    assert errors.pearson is not None
    assert errors.pearson < 0.9


def test_some_points_keep_their_pairs():
    errors = SurfaceErrors(np.arange(50.0), np.arange(50.0) * 2)
    some = errors.some(10)
    assert len(some.error) == 10
    np.testing.assert_array_equal(2 * some.error, some.sigma)


def test_a_right_estimate_has_no_error_and_the_sigma_of_its_translation():
    state = toy_state()
    matrix = np.zeros((LENGTH, LENGTH))
    matrix[3, 3] = 0.02**2  # along the object's x axis
    errors = surface_errors(toy_prior(), state, covariance(matrix), truth_of(state), points=3000)
    # the toy's blocks overlap: what of them lies within another is not seen
    outside = errors.error < 1e-4
    assert outside.mean() > 0.97
    sigma = errors.sigma[outside]
    sideways = sigma > 0.01
    # a face that looks along x moves with the object, any other does not; not so at the edges, which are rounded
    assert np.mean(np.isclose(sigma[sideways], 0.02, atol=2e-4)) > 0.95
    assert np.mean(sigma[~sideways] < 2e-4) > 0.95
    mesh = toy_mesh(state.code)
    mesh.apply_scale(state.scale)
    share = mesh.area_faces[np.abs(mesh.face_normals[:, 0]) > 0.9].sum() / mesh.area
    assert sideways.mean() == pytest.approx(share, abs=0.08)


def test_surfaces_are_known_as_well_as_the_prior_makes_them():
    state, matrix = toy_state(), np.diag(np.linspace(1e-4, 1e-3, LENGTH))
    usual = surface_errors(toy_prior(), state, covariance(matrix), truth_of(state), points=500)
    prior = replace(toy_prior(), surface_misfit=4.0)
    worse = surface_errors(prior, state, covariance(matrix), truth_of(state), points=500)
    np.testing.assert_allclose(worse.sigma, 2 * usual.sigma)
    np.testing.assert_array_equal(worse.error, usual.error)
    assert worse.pearson == pytest.approx(usual.pearson)


def test_a_shifted_estimate_is_off_by_the_shift():
    state = toy_state()
    T = state.T_world_object
    moved = replace(state, T_world_object=T.compose(gtsam.Pose3(gtsam.Rot3(), np.array([0, 0.015, 0]))))
    errors = surface_errors(toy_prior(), moved, covariance(np.eye(LENGTH)), truth_of(state), points=3000)
    upper = np.isclose(errors.error, 0.015, atol=5e-4)
    assert 0.2 < upper.mean() < 0.7
    assert errors.error.max() < 0.25


def test_sigma_is_that_of_the_joint_covariance_by_numerical_derivatives():
    rng = np.random.default_rng(5)
    prior = fallback_prior("sofa")
    prior.decoder.double()
    code = np.array(prior.code_mean, float)
    state = replace(toy_state(), code=code)
    root = 0.01 * rng.normal(size=(9 + len(code), 9 + len(code)))
    matrix = root @ root.T
    truth = truth_of(toy_state())
    errors = surface_errors(prior, state, covariance(matrix), truth, points=200, seed=4)
    p_world = seen_points_on(PlacedMesh.of_truth(truth), 200, seed=4)

    def sdf(state: ObjectState, p_world: np.ndarray) -> np.ndarray:
        points, codes = torch.as_tensor(state.to_object(p_world)), torch.as_tensor(np.array(state.code))
        with torch.no_grad():
            return prior.decoder(points, codes[None]).numpy()

    def derivatives(f, size: int) -> np.ndarray:
        return np.stack([(f(e) - f(-e)) / 2e-6 for e in 1e-6 * np.eye(size)], axis=1)

    gradient = derivatives(lambda e: sdf(state, p_world + e), 3)
    canonical = gradient @ state.T_world_object.rotation().matrix() * state.scale
    norm = np.linalg.norm(canonical, axis=1)
    trusted = (norm > 0.5) & (norm < 2)
    assert trusted.mean() > 0.9

    def metric(state: ObjectState) -> np.ndarray:
        """The decoder's gradient is held, the scale is not (`factors.sdf.MetricSdf`)."""
        return sdf(state, p_world) / np.linalg.norm(canonical * np.exp(-state.log_scale), axis=1)

    J = derivatives(lambda e: metric(state.retract(e)), len(matrix))
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", J, matrix, J))
    np.testing.assert_allclose(errors.sigma[trusted], sigma[trusted], rtol=1e-3)
    np.testing.assert_allclose(errors.error[trusted], np.abs(metric(state))[trusted], rtol=1e-3)


def test_the_binned_correlation_is_that_of_100_means():
    rng = np.random.default_rng(3)
    sigma = rng.lognormal(-5, 0.5, 10_000)
    error = np.abs(rng.normal(size=10_000)) * sigma
    found = SurfaceErrors(error, sigma)
    order = np.argsort(sigma)
    means = np.array(
        [[values[order][i : i + 100].mean() for i in range(0, 10_000, 100)] for values in (sigma, error)]
    )
    assert found.pearson_binned == pytest.approx(np.corrcoef(means)[0, 1])
    # averaging takes away the errors' own chance, not what sigma does not know
    assert found.pearson is not None
    assert found.pearson_binned is not None
    assert found.pearson_binned > found.pearson + 0.2
    unrelated = SurfaceErrors(rng.permutation(error), sigma)
    assert unrelated.pearson_binned is not None
    assert abs(unrelated.pearson_binned) < 0.35
    assert SurfaceErrors(error, np.full(10_000, 0.01)).pearson_binned is None
    assert SurfaceErrors(error[:2], sigma[:2]).pearson_binned is None
