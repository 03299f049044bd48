"""Which views tell one heading of an object from another, and what that is worth."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from factors.state import ObjectState
from objgraph.active import headings
from objgraph.active.cameras import looking_at, sphere
from objgraph.active.headings import OtherHeading, risk
from objgraph.active.next_view import (
    NextViewConfig,
    ViewGain,
    divergence,
    expected_information,
    next_views,
    visible,
)
from objgraph.active.target import Target, target
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.sides import SideMisfit, seen_sides
from objgraph.covariance.surface import metric_sdf_jacobian
from objgraph.errors import SolveError
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.observation.sampling import independent_shares
from tests.objgraph.active.test_next_view import ALONE, scene_of
from tests.toys import INTRINSICS, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
CONFIG = NextViewConfig(INTRINSICS)
COVARIANCE = ObjectCovariance.diagonal(np.square(np.linspace(0.01, 0.05, 13)), "marginals", "chair")


def turned(state: ObjectState, angle: float) -> ObjectState:
    turn = gtsam.Pose3(gtsam.Rot3.Ry(angle), np.zeros(3))
    return replace(state, T_world_object=state.T_world_object.compose(turn))


@pytest.fixture(scope="module")
def doubtful() -> Target:
    """A toy chair that stands as it was found or, as likely, the other way round."""
    state = toy_state()
    turns = HeadingModes(np.array([0.495, 0.01, 0.495, 0.0]), (state, state, turned(state, np.pi), None))
    return target("chair", toy_prior(), state, COVARIANCE, turns=turns)


def corners_of(state: ObjectState, p_object: np.ndarray) -> np.ndarray:
    low, high = p_object.min(axis=0), p_object.max(axis=0)
    picks = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return state.to_world(np.where(picks, high, low))


def test_the_corners_derivative_is_the_numerical_one(doubtful):
    state, step = toy_state(), 1e-6
    p_object = state.to_object(doubtful.vertices)
    rows = doubtful.corner_jacobian.reshape(8, 3, 9)
    for k, e in enumerate(np.eye(13)[:9]):
        ends = [corners_of(state.retract(sign * step * e), p_object) for sign in (1, -1)]
        np.testing.assert_allclose(rows[:, :, k], (ends[0] - ends[1]) / (2 * step), atol=1e-6)


def test_without_other_headings_the_gain_is_the_corners_variance_that_goes(doubtful):
    known = replace(doubtful, others=(), probability=1.0)
    camera = sphere(known.centre, 2.2, UP, 5, (10.0, 50.0))[2]
    gain = next_views([known], [camera], ALONE)[0].objects["chair"]
    scene = scene_of((known.vertices, known.faces))
    added = expected_information(known, camera, visible(known, camera, scene, CONFIG), CONFIG)
    J = known.corner_jacobian
    spread = [
        np.trace(J @ np.linalg.inv(H)[:9, :9] @ J.T) / 8
        for H in (known.information, known.information + added)
    ]
    assert gain.corners == pytest.approx(spread[0] - spread[1])


def test_sides_that_are_first_seen_err_less(doubtful):
    """By definition: corners lie at a lower or an upper side of each axis, and what is within 6 cm of seen points is seen."""
    first, second = (sphere(doubtful.centre, 2.2, UP, 5, (10.0, 50.0))[i] for i in (2, 4))
    known = replace(doubtful, others=(), probability=1.0, seen_from=(first,))
    scene = scene_of((known.vertices, known.faces))
    apart = np.linalg.norm(known.points[:, None] - known.points, axis=2)
    state, misfit = toy_state(), SideMisfit(marginals=2.0, seen=0.01, unseen=0.1)
    extents = np.ptp(state.to_object(known.vertices), axis=0) * state.scale
    seen, squares, surface = np.zeros(len(apart), bool), [], []
    for camera in (first, second):
        seen |= (apart[:, visible(known, camera, scene, CONFIG)] < 0.06).any(axis=1)
        shares = seen_sides(state, known.points, seen, known.stands)
        squares.append(sum(np.square(misfit.sigma(extents, shares)[axis]).mean() for axis in range(3)))
        surface.append(np.where(seen, 0.01**2, (0.1 * extents.mean()) ** 2).mean())
    of_both = next_views([known], [second], replace(CONFIG, sides=misfit))[0].objects["chair"]
    of_marginals = next_views([known], [second], ALONE)[0].objects["chair"]
    assert squares[0] > squares[1]
    assert of_both.corners == pytest.approx(2 * of_marginals.corners + squares[0] - squares[1])
    assert of_both.surface == pytest.approx(of_marginals.surface + surface[0] - surface[1])


def test_a_cost_is_worth_to_a_view_what_it_was_to_the_estimate(doubtful):
    """Where more of it is one nat, a view is expected to tell less of headings."""
    cameras = sphere(doubtful.centre, 2.2, UP, 5, (10.0, 50.0))

    def gains(temperature: float) -> np.ndarray:
        known = replace(doubtful, temperature=temperature)
        return np.array(
            [v.objects["chair"].corners for v in sorted_by_camera(next_views([known], cameras, CONFIG))]
        )

    assert doubtful.temperature == HeadingModesConfig.temperature  # of a prior without a guess
    alone = replace(doubtful, others=(), probability=1.0)
    rest = np.array(
        [v.objects["chair"].corners for v in sorted_by_camera(next_views([alone], cameras, CONFIG))]
    )
    told = [gains(temperature) - rest for temperature in (5.0, 30.0, 1e9)]
    assert (told[0] > told[1] + 1e-6).any()
    assert (told[0] >= told[1] - 1e-12).all()
    np.testing.assert_allclose(told[2], 0.0, atol=1e-6)


def sorted_by_camera(views: list[ViewGain]) -> list[ViewGain]:
    return sorted(views, key=lambda view: tuple(view.T_world_camera.translation()))


def test_headings_that_are_likely_are_kept_with_their_distance(doubtful):
    (other,) = doubtful.others  # one of 1 % is not asked about
    assert doubtful.probability == other.probability == 0.495
    state = toy_state()
    p_object = state.to_object(doubtful.vertices)
    moved = corners_of(turned(state, np.pi), p_object) - corners_of(state, p_object)
    assert other.square_distance == pytest.approx(np.square(moved).sum(axis=1).mean())
    np.testing.assert_allclose(
        other.of_own, metric_sdf_jacobian(toy_prior().decoder, turned(state, np.pi), doubtful.points)[0]
    )
    assert (
        np.abs(metric_sdf_jacobian(toy_prior().decoder, turned(state, np.pi), other.points)[0]).max() < 0.02
    )
    assert np.abs(other.to_own).max() > 0.1


def test_a_heading_without_a_surface_is_not_asked_about(monkeypatch):
    """... and does not take the object down."""
    state, sampled = toy_state(), headings.sample_surface

    def sample(prior, at, *settings):
        if at is not state:
            raise SolveError("the code has no surface")
        return sampled(prior, at, *settings)

    monkeypatch.setattr(headings, "sample_surface", sample)
    turns = HeadingModes(np.array([0.5, 0.0, 0.5, 0.0]), (state, None, turned(state, np.pi), None))
    found = target("chair", toy_prior(), state, COVARIANCE, turns=turns)
    assert found.others == ()


@given(st.floats(0.01, 0.99), st.floats(0.0, 60.0))
def test_the_risk_is_no_less_than_that_of_the_best_decision(probability, nats):
    """Of two Gaussians so many nats apart, told from each other by the likelihood ratio."""
    none = np.zeros((1, 3))
    other = OtherHeading(
        none, none, np.zeros(1), none, np.zeros((0, 3), int),
        probability=1 - probability, square_distance=0.7, to_own=np.zeros(1), of_own=np.zeros(1),
    )  # fmt: skip
    apart = max(np.sqrt(2 * nats), 1e-9)  # in standard deviations
    edge = np.log(probability / (1 - probability)) / apart
    mistaken = probability * norm.sf(apart / 2 + edge) + (1 - probability) * norm.cdf(-apart / 2 + edge)
    bound = risk(probability, [other], [nats])
    assert bound >= 0.7 * mistaken - 1e-12
    assert bound <= 0.7 * np.sqrt(probability * (1 - probability)) + 1e-12


def test_the_divergence_is_that_of_the_points_seen(doubtful):
    (other,) = doubtful.others
    camera = sphere(doubtful.centre, 2.2, UP, 5, (10.0, 50.0))[1]
    scene = scene_of((doubtful.vertices, doubtful.faces))
    total, seen = 0.0, np.flatnonzero(visible(doubtful, camera, scene, CONFIG))
    p_camera = np.array([camera.transformTo(doubtful.points[i]) for i in seen])
    for i, p, share in zip(
        seen, p_camera, independent_shares(p_camera, CONFIG.correlation_length, most=0.25), strict=True
    ):
        sigma = np.hypot(CONFIG.noise(p[2:])[0], doubtful.residual[i])
        # of N(0, sigma) from N(of_own, sigma), no more than three sigma off; twice, for two factors
        total += 2 * share * min((other.of_own[i] / sigma) ** 2, 9.0) / 2
    assert divergence(doubtful, other.of_own, camera, scene, CONFIG) == pytest.approx(total)
    assert divergence(doubtful, np.zeros(len(doubtful.points)), camera, scene, CONFIG) == 0.0


def test_a_view_that_shows_the_difference_is_worth_more(doubtful):
    (other,) = doubtful.others
    cameras = sphere(doubtful.centre, 2.2, UP, 8, (10.0, 50.0))
    gains = [view.objects["chair"].corners for view in next_views([doubtful], cameras, CONFIG)]
    certain = replace(doubtful, others=(), probability=1.0)
    plain = [view.objects["chair"].corners for view in next_views([certain], cameras, CONFIG)]
    assert min(gains) > 10 * max(plain)
    assert max(gains) - max(plain) <= risk(doubtful.probability, doubtful.others, [0.0])
    alike = replace(other, of_own=np.zeros(len(other.of_own)), to_own=np.zeros(len(other.to_own)))
    same = next_views([replace(doubtful, others=(alike,))], cameras, CONFIG)
    assert [view.objects["chair"].corners for view in same] == pytest.approx(plain)
    away = looking_at(doubtful.centre + [2.0, 0.0, 1.0], doubtful.centre + [4.0, 0.0, 1.0], UP)
    assert next_views([doubtful], [away], CONFIG)[0].total("corners") == 0.0
