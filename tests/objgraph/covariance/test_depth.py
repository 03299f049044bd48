"""The depth that a camera would measure of an uncertain object."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch
from scipy.stats import norm

from factors.state import ObjectState
from objgraph.covariance import depth as depth_module
from objgraph.covariance.depth import predicted_depth
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import CovarianceError
from tests.factors.conftest import CODE_LENGTH, SphereDecoder

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


class PlateDecoder(SphereDecoder):
    """A plate, 0.66 wide and 0.0134 thick."""

    def _network(self, points, injected):
        beyond = points.abs() - torch.tensor([0.33, 0.33, 0.0067]).to(points)
        outside = (beyond.clamp_min(0).square().sum(dim=1) + 1e-14).sqrt()
        return outside + beyond.amax(dim=1).clamp_max(0) + 0 * injected["0"][:, 0]


@pytest.mark.parametrize("along", [0.0005, 0.01, 0.1])
@pytest.mark.parametrize("offset", [0.0, 0.004, 0.008, 0.012, 0.016, 0.02])
def test_a_thin_plate_is_not_missed_between_samples(along, offset):
    """2 cm thick: 98 % by the occupancy's slope where its place is known, and its depth as uncertain as its place."""
    pose = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 3.0 + offset]))
    state = ObjectState(pose, np.full(3, np.log(1.5)), np.zeros(CODE_LENGTH))
    rays = np.array([[0.0, 0.0, 1.0], [0.05, 0.02, 1.0], [0.08, 0.02, 1.0]])
    found = predicted_depth(PlateDecoder(), state, uncertain(along), CAMERA, rays)
    assert (found.hit > 0.97).all()
    np.testing.assert_allclose(found.sigma, np.hypot(along, 0.0041), rtol=0.03)
    many = predicted_depth(PlateDecoder(), state, uncertain(along), CAMERA, rays, samples=2000)
    np.testing.assert_allclose(found.hit, many.hit, atol=0.01)
    np.testing.assert_allclose(found.mean, many.mean, atol=1e-3 + 0.01 * along)
    np.testing.assert_allclose(found.sigma, many.sigma, rtol=0.03)


def drawn(state: ObjectState, covariance: ObjectCovariance, rays: np.ndarray) -> np.ndarray:
    """Depths of spheres drawn from the covariance, of one scale in all directions; NaN where rays pass."""
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(14), covariance.matrix, 50_000)
    centres = state.T_world_object.translation() + draws[:, 3:6]
    radius = 0.4 * state.scale[0] * np.exp(draws[:, 6])
    d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    b = centres @ d.T
    inside = b**2 - (np.square(centres).sum(axis=1) - radius**2)[:, None]
    return np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) * d[:, 2], np.nan)


@pytest.mark.parametrize(
    ("along", "across"), [(0.005, 1e-4), (0.1, 1e-4), (0.2, 1e-4), (0.1, 0.01), (0.3, 0.01)]
)
def test_an_object_that_may_be_far_off_along_the_view_is_hit_there(along, across):
    """However far beyond the box of where it is estimated to be; with the samples that one has without asking."""
    pose = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 2.0]))
    state = ObjectState(pose, np.full(3, np.log(0.3)), np.zeros(CODE_LENGTH))
    rays, covariance = towards(0.0, 0.015, 0.03), uncertain(along, across)
    blur = 0.00425 / np.sqrt(
        1 - (rays[:, 0] * 2.0 / 0.12) ** 2
    )  # of the occupancy's slope, along slanted rays
    depth = drawn(state, covariance, rays) + blur * np.random.default_rng(1).normal(size=(50_000, 3))
    found = predicted_depth(SPHERE, state, covariance, CAMERA, rays)
    np.testing.assert_allclose(found.hit, np.isfinite(depth).mean(axis=0), atol=0.01)
    np.testing.assert_allclose(found.mean, np.nanmean(depth, axis=0), atol=0.002 + 0.01 * along)
    np.testing.assert_allclose(found.sigma, np.nanstd(depth, axis=0), rtol=0.05)
    for share in (0.05, 0.5, 0.95):
        np.testing.assert_allclose(
            found.quantile(share), np.nanquantile(depth, share, axis=0), atol=0.003 + 0.05 * along
        )


class CabinetDecoder(SphereDecoder):
    """A box, 0.6 wide, 0.8 high and 0.4 deep."""

    def _network(self, points, injected):
        beyond = points.abs() - torch.tensor([0.3, 0.4, 0.2]).to(points)
        outside = (beyond.clamp_min(0).square().sum(dim=1) + 1e-14).sqrt()
        return outside + beyond.amax(dim=1).clamp_max(0) + 0 * injected["0"][:, 0]


@pytest.mark.parametrize("samples", [64, 400])
@pytest.mark.parametrize("along", [0.001, 0.005, 0.02])
def test_rays_that_pass_an_outline_hit_as_often_as_it_comes_over_them(along, samples):
    """However little the object may move along the view: half of rays at the outline, next to none at three deviations."""
    state = replace(STATE, T_world_object=gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 2.2])))
    beside = np.array([0.005, 0.01, 0.02, 0.04, 0.06])  # metres from the front's outline, which is 2 m away
    rays = towards(*((0.3 + beside) / 2))
    found = predicted_depth(
        CabinetDecoder(), state, uncertain(along, across=0.02), CAMERA, rays, samples=samples
    )
    blurred = np.hypot(0.02, 0.00425)  # by the occupancy's slope
    np.testing.assert_allclose(found.hit, norm.sf(beside / blurred), atol=0.02)


def turning(covariance: ObjectCovariance, degrees: float) -> ObjectCovariance:
    """The heading is known to so much."""
    matrix = covariance.matrix.copy()
    matrix[1, 1] = np.radians(degrees) ** 2
    return ObjectCovariance.of(matrix, "marginals")


@pytest.mark.parametrize("degrees", [10.0, 20.0, 60.0, 104.0, 1e5])
def test_what_is_round_ends_rays_where_it_does_whatever_its_heading(degrees):
    """At 104 degrees, where nothing tells it, a ray in 20 cm from the sphere hit it, and one on it ended before it."""
    rays, covariance = towards(0.0, 0.05, 0.1, 0.13, 0.2), uncertain(0.01, across=0.01)
    known = predicted_depth(SPHERE, STATE, covariance, CAMERA, rays)
    found = predicted_depth(SPHERE, STATE, turning(covariance, degrees), CAMERA, rays)
    np.testing.assert_allclose(found.hit, known.hit, atol=2e-3)
    np.testing.assert_allclose(found.mean, known.mean, atol=2e-3)
    np.testing.assert_allclose(found.sigma, known.sigma, atol=2e-3)


@pytest.mark.parametrize("degrees", [20.0, 40.0, 104.0])
def test_a_heading_that_is_not_known_is_what_draws_of_it_show(degrees):
    """Of a cabinet: linear in its heading it ended rays half a metre before where any heading has it."""
    half, place = np.array([0.3, 0.4, 0.2]), np.array([0.0, 0.0, 2.2])
    rays, rng = towards(0.0, 0.06, 0.1, 0.13, 0.15, 0.18, 0.22), np.random.default_rng(0)
    turn, moved = np.radians(degrees) * rng.normal(size=5000), 0.01 * rng.normal(size=(5000, 3))
    R = np.moveaxis(
        np.array(
            [[np.cos(turn), 0 * turn, np.sin(turn)], [0 * turn, 1 + 0 * turn, 0 * turn],
             [-np.sin(turn), 0 * turn, np.cos(turn)]]
        ), 2, 0,
    )  # fmt: skip
    eye = -np.einsum("nij,ni->nj", R, place + moved)[:, None]
    along = np.einsum("nij,ri->nrj", R, rays) + 1e-12
    sides = np.stack([(-half - eye) / along, (half - eye) / along])
    near, far = sides.min(axis=0).max(axis=-1), sides.max(axis=0).min(axis=-1)
    depth = np.where(far > near, near, np.nan)
    state = replace(STATE, T_world_object=gtsam.Pose3(gtsam.Rot3(), place))
    found = predicted_depth(
        CabinetDecoder(), state, turning(uncertain(0.01, across=0.01), degrees), CAMERA, rays
    )
    np.testing.assert_allclose(found.hit, np.isfinite(depth).mean(axis=0), atol=0.08)
    often = np.isfinite(depth).mean(axis=0) > 0.1
    np.testing.assert_allclose(found.mean[often], np.nanmean(depth[:, often], axis=0), atol=0.02)
    np.testing.assert_allclose(found.sigma[often], np.nanstd(depth[:, often], axis=0), atol=0.02)


@pytest.mark.parametrize("grows", [0.05, 0.1, 0.15])
def test_an_object_that_may_be_larger_than_its_box_is_hit_before_it(grows):
    matrix = 1e-10 * np.eye(14)
    matrix[6:9, 6:9] += grows**2
    covariance = ObjectCovariance.of(matrix, "marginals")
    depth = drawn(STATE, covariance, towards(0.0))
    found = predicted_depth(SPHERE, STATE, covariance, CAMERA, towards(0.0))
    assert found.hit[0] > 0.999
    np.testing.assert_allclose(found.mean, depth.mean(), atol=0.006)
    np.testing.assert_allclose(found.sigma, np.hypot(depth.std(), 0.00425), rtol=0.03)


@pytest.mark.parametrize("along", [0.005, 0.02, 0.04])
def test_a_side_that_was_seen_stays_known_where_size_and_place_are_not(along):
    """The sphere's far side is uncertain, its near one is not: centre and radius go along with each other."""
    matrix = np.diag(np.array([1e-4] * 5 + [0.003] + [1e-4] * 8) ** 2)
    together = np.zeros(14)
    together[5], together[6:9] = 1.0, 1.0 / 0.4
    covariance = ObjectCovariance.of(matrix + along**2 * np.outer(together, together), "marginals")
    found = predicted_depth(SPHERE, STATE, covariance, CAMERA, towards(0.0))
    assert found.hit[0] > 0.999
    np.testing.assert_allclose(found.quantile(0.5), 2.6, atol=1e-3)
    middle = found.quantile(0.75) - found.quantile(0.25)
    np.testing.assert_allclose(middle, 1.349 * np.hypot(0.003, 0.00425), rtol=0.1)


def test_many_rays_are_decoded_some_at_a_time(monkeypatch):
    asked = []

    class Counting(SphereDecoder):
        def linearize(self, points, codes, owner=None):
            asked.append(len(points))
            return super().linearize(points, codes, owner)

    rays = towards(*np.linspace(-0.2, 0.2, 1200))
    found = predicted_depth(Counting(), STATE, uncertain(0.02), CAMERA, rays)
    assert max(asked) <= 2**15
    monkeypatch.setattr(depth_module, "_PLACES_AT_ONCE", 64 * 7)
    again = predicted_depth(SPHERE, STATE, uncertain(0.02), CAMERA, rays)
    np.testing.assert_allclose(again.reached[:, -1], found.hit, atol=1e-3)
    np.testing.assert_allclose(again.mean, found.mean, atol=1e-3)


def test_a_quantile_is_the_first_depth_by_which_the_share_is_reached():
    depths = np.array([[1.0, 2.0, 3.0, 4.0, 5.0]])
    found = depth_module.DepthDistribution(depths, np.array([[0.0, 0.2, 0.2, 0.4, 0.4]]))
    shares = [0.0, 0.25, 0.5, 0.75, 1.0]
    assert [found.quantile(share)[0] for share in shares] == pytest.approx([1.0, 1.5, 2.0, 3.5, 4.0])


@pytest.mark.parametrize("share", [-0.1, 1.1, np.nan, "all", None])
def test_a_share_that_is_none_has_no_quantile(share):
    found = predicted_depth(SPHERE, STATE, uncertain(0.05), CAMERA, towards(0.0))
    with pytest.raises(CovarianceError, match="the share of a quantile"):
        found.quantile(share)
