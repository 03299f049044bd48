"""The depth that a camera would measure of an uncertain object."""

import gtsam
import numpy as np

from factors.state import ObjectState
from objgraph.covariance.depth import predicted_depth
from objgraph.covariance.labelled import ObjectCovariance
from tests.factors.conftest import SphereDecoder

SPHERE = SphereDecoder()
STATE = ObjectState(gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 3.0])), np.zeros(3), np.zeros(5))
CAMERA = gtsam.Pose3()


def towards(*x: float) -> np.ndarray:
    return np.array([[each, 0.0, 1.0] for each in x])


def uncertain(along: float, across: float = 1e-4) -> ObjectCovariance:
    """The sphere's place is uncertain along the view and across it."""
    sigma = np.array([1e-4, 1e-4, 1e-4, across, across, along, 1e-4, 1e-4, 1e-4, *[1e-4] * 5])
    return ObjectCovariance.diagonal(sigma**2, "marginals")


def test_along_the_middle_it_is_a_gaussian_about_the_surface():
    found = predicted_depth(SPHERE, STATE, uncertain(0.05), CAMERA, towards(0.0), samples=400)
    assert found.hit[0] > 0.999
    np.testing.assert_allclose(found.mean, 2.6, atol=2e-3)
    np.testing.assert_allclose(found.sigma, 0.05, atol=2e-3)
    np.testing.assert_allclose(found.quantile(0.975) - found.quantile(0.5), 1.96 * 0.05, atol=4e-3)


def test_it_is_what_draws_of_the_place_show():
    """Beside the outline, where the linear model of the SDF is only one: hits within 3 %, depths within a centimetre."""
    rng = np.random.default_rng(0)
    rays, along, across = towards(0.0, 0.08, 0.12), 0.03, 0.02
    centres = np.array([0.0, 0.0, 3.0]) + rng.normal(size=(20_000, 3)) * [across, across, along]
    d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    b = centres @ d.T
    inside = b**2 - (np.square(centres).sum(axis=1) - 0.4**2)[:, None]
    depth = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) * d[:, 2], np.nan)
    found = predicted_depth(SPHERE, STATE, uncertain(along, across), CAMERA, rays, samples=400)
    np.testing.assert_allclose(found.hit, np.isfinite(depth).mean(axis=0), atol=0.03)
    np.testing.assert_allclose(found.mean, np.nanmean(depth, axis=0), atol=0.01)
    np.testing.assert_allclose(found.sigma, np.nanstd(depth, axis=0), atol=0.01)


def test_rays_that_miss_the_box_end_nowhere():
    found = predicted_depth(SPHERE, STATE, uncertain(0.05), CAMERA, towards(0.0, 3.0))
    assert found.hit[1] == 0.0
    assert np.isnan(found.mean[1])
    assert np.isnan(found.quantile(0.5)[1])
    assert (np.diff(found.reached, axis=1) >= 0).all()
    empty = predicted_depth(SPHERE, STATE, uncertain(0.05), CAMERA, towards(3.0))
    assert not empty.hit.any()


def test_the_decoders_own_error_widens_it():
    sure = predicted_depth(SPHERE, STATE, uncertain(0.01), CAMERA, towards(0.0), samples=400)
    unsure = predicted_depth(
        SPHERE, STATE, uncertain(0.01), CAMERA, towards(0.0), residual_sigma=0.03, samples=400
    )
    np.testing.assert_allclose(unsure.sigma, np.hypot(sure.sigma, 0.03), rtol=0.05)
