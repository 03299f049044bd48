"""The gate between a detection and a mapped object keeps its stated rate."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.stats import binom, chi2

from factors.rays import Rays
from factors.state import ObjectState
from factors.superquadric import SEMI_AXIS, Superquadric
from objgraph.observation.sampling import ObjectView
from objgraph.slam.association import AssociationConfig, Detection, MappedCandidate
from objgraph.slam.association.gate import Pair
from tests.objgraph.slam.association_cases import chair_views, compare_all, compare_one, mapped, seen
from tests.toys import look_at, toy_state

EGG = Superquadric()
ROUND = -20.0
"""Section and profile of the code of an ellipsoid."""


def egg_view(state: ObjectState, T_world_camera: gtsam.Pose3, rng, count=60, sigma=0.005) -> ObjectView:
    """What a camera sees of a tapered ellipsoid, in closed form; each point errs by itself."""
    u = rng.normal(size=(6 * count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    slope = 0.3 * np.tanh(state.code[2])
    width = 1 + slope * u[:, 1]
    p_object = SEMI_AXIS * u * np.stack([width, np.ones_like(width), width], axis=1)
    level = (u[:, 0] ** 2 + u[:, 2] ** 2) * slope
    normal = np.stack([u[:, 0] / width, u[:, 1] - level / width, u[:, 2] / width], axis=1)
    R_world_object = state.T_world_object.rotation().matrix()
    p_world = state.to_world(p_object)
    towards = p_world - T_world_camera.translation()
    seen = np.flatnonzero((towards * (normal / state.scale @ R_world_object.T)).sum(axis=1) < 0)[:count]
    p_camera = towards[seen] @ T_world_camera.rotation().matrix()
    # a quarter of a measurement each: its variance is four times that of the sensor
    p_camera += rng.normal(size=p_camera.shape) * 2 * sigma
    depth = p_camera[:, 2]
    hit = np.ones(len(depth), bool)
    rays = Rays(p_camera / depth[:, None], depth, hit, depth + 1, np.full(len(depth), sigma))
    return ObjectView(
        "egg", T_world_camera, p_camera, np.full(len(depth), sigma), rays, correlation_length=1e-4
    )


def random_covariance(rng, sigma) -> np.ndarray:
    """Of these standard deviations, strongly correlated."""
    A = rng.normal(size=(len(sigma), len(sigma)))
    S = A @ A.T
    return S * np.outer(sigma, sigma) / np.sqrt(np.outer(np.diag(S), np.diag(S)))


def drawn_pair(rng, with_camera: bool) -> Pair:
    """An egg's estimate (and a camera's), and what a truth drawn from their covariance shows."""
    R = gtsam.Rot3.Rz(rng.uniform(0, 6)).compose(gtsam.Rot3.Rx(np.pi / 2))
    code = np.array([ROUND, ROUND, rng.normal()])
    estimate = ObjectState(gtsam.Pose3(R, rng.normal(size=3)), np.log([0.9, 1.1, 1.0]), code)
    centre, heading = estimate.T_world_object.translation(), rng.uniform(0, 6)
    T_world_camera = gtsam.Pose3(
        look_at(centre + [2.2 * np.cos(heading), 2.2 * np.sin(heading), 1.0], centre)
    )
    sigma = np.repeat([0.03, 0.04, 0.03, 0.2, 0.01, 0.03], 3)[: 18 if with_camera else 12]
    covariance = random_covariance(rng, sigma)
    delta = rng.multivariate_normal(np.zeros(len(sigma)), covariance)
    T_true = T_world_camera.retract(delta[12:]) if with_camera else T_world_camera
    view = egg_view(estimate.retract(delta[:12]), T_true, rng)
    return Pair(
        view, T_world_camera, MappedCandidate("egg", "egg", EGG, estimate, lambda: covariance), covariance
    )


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(1)
    return [drawn_pair(rng, True) for _ in range(300)] + [drawn_pair(rng, False) for _ in range(100)]


@pytest.fixture(scope="module")
def drawn_fits(drawn):
    return compare_all(drawn, AssociationConfig(unmodelled=0.0))


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_truths_drawn_from_the_joint_covariance_pass_at_the_stated_rate(drawn_fits, probability):
    low, high = binom.interval(0.999, len(drawn_fits), probability)
    passed = sum(fit.squared <= chi2.ppf(probability, fit.directions) for fit in drawn_fits)
    assert low <= passed <= high


def test_without_the_cross_blocks_the_rate_is_another(drawn, drawn_fits):
    """The camera's correlation with the object is used, not its variance alone."""
    blind = []
    for pair in drawn[:100]:
        covariance = pair.covariance.copy()
        covariance[:12, 12:] = covariance[12:, :12] = 0
        blind.append(replace(pair, covariance=covariance))
    cut = compare_all(blind, AssociationConfig(unmodelled=0.0))
    ratio = [a.squared / b.squared for a, b in zip(drawn_fits[:100], cut, strict=True)]
    assert np.percentile(ratio, 5) < 0.8
    assert np.percentile(ratio, 95) > 1.25


def test_an_object_a_metre_away_is_refused(drawn):
    away = []
    for pair in drawn[:50]:
        state = pair.candidate.state
        T = state.T_world_object
        elsewhere = gtsam.Pose3(T.rotation(), T.translation() + [1.0, 0.0, 0.0])
        moved = replace(pair.candidate, state=replace(state, T_world_object=elsewhere))
        away.append(replace(pair, candidate=moved))
    config = AssociationConfig()
    assert all(fit.refusal(config) for fit in compare_all(away, config))
    assert sum(fit.refusal(config) is None for fit in compare_all(drawn[:50], config)) >= 48


def test_a_plane_says_where_it_is_along_its_normal_alone():
    state = toy_state()
    rng = np.random.default_rng(0)
    seat = np.stack([rng.uniform(-0.2, 0.2, 50), np.full(50, 0.022), rng.uniform(-0.2, 0.1, 50)], axis=1)
    (view,) = chair_views([state], 0.4)
    p_world = state.to_world(seat) + [0.0, 0.0, 0.03] + rng.normal(size=(50, 3)) * 0.003
    p_camera = (p_world - view.T_world_camera.translation()) @ view.T_world_camera.rotation().matrix()
    flat = replace(view, points_camera=p_camera, points_sigma=np.full(50, 0.005))
    fit = compare_one(Detection(flat, "chair"), mapped(state))
    assert fit.directions == 1
    np.testing.assert_allclose(fit.offset_world, [0.0, 0.0, -0.03], atol=3e-3)


@pytest.mark.parametrize("azimuth", [0.6, 2.0, 4.0])
def test_rays_that_pass_through_what_is_mapped_contradict_it(azimuth):
    """A narrow chair, where a map has a wide one: its points lie on that, but rays beside it pass through."""
    narrow, wide = (replace(toy_state(), code=np.array([width, 2.0, 0.3, 0.2])) for width in (-3.0, 4.0))
    (detection,) = seen([narrow], azimuth)
    wrong, right = compare_one(detection, mapped(wide)), compare_one(detection, mapped(narrow))
    assert right.contradicted < 0.05
    assert wrong.contradicted > 0.2
    assert wrong.overlap > 0.5
    strict = AssociationConfig(contradicted=0.2)
    assert right.refusal(strict) is None
    assert "of the rays beside it pass through" in (wrong.refusal(strict) or "")
