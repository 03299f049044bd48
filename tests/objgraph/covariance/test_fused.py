"""Two estimates as one: what both say of the world is what comes out, in whatever tangents they say it."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.state import ObjectState
from objgraph.covariance.frames import in_world
from objgraph.covariance.fused import fused
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import CovarianceError

CODE = 2
SIGMAS = np.array([0.02, 0.03, 0.05, 0.01, 0.1, 0.02, 0.1, 0.1, 0.1, 0.5, 0.5])


def estimate(heading: float, centre, world: np.ndarray = SIGMAS) -> tuple[ObjectState, ObjectCovariance]:
    """A state, and the covariance in its tangent that is diagonal along the world's axes."""
    R = gtsam.Rot3.Rz(heading).compose(gtsam.Rot3.Rx(np.pi / 2))
    state = ObjectState(gtsam.Pose3(R, np.array(centre)), np.zeros(3), np.zeros(CODE))
    into = np.eye(len(world))
    into[:3, :3] = into[3:6, 3:6] = R.matrix().T
    return state, ObjectCovariance.of(into @ np.diag(world**2) @ into.T, "marginals")


@given(
    heading=st.floats(-1.0, 1.0), share=st.floats(0.1, 0.9), x=st.floats(-0.1, 0.1), y=st.floats(-0.1, 0.1)
)
def test_two_that_say_the_same_of_a_centre_keep_its_ellipsoid_and_meet_between_them(heading, share, x, y):
    state, covariance = fused(estimate(0.2, (0.0, 0.0, 0.0)), estimate(0.2 + heading, (x, y, 0.0)), share)
    np.testing.assert_allclose(
        state.T_world_object.translation(), (1 - share) * np.array([x, y, 0.0]), atol=1e-9
    )
    world = in_world(covariance, state.T_world_object.rotation()).matrix
    np.testing.assert_allclose(world[3:6, 3:6], np.diag(SIGMAS[3:6] ** 2), atol=1e-9)
    np.testing.assert_allclose(np.sqrt(world[2, 2]), SIGMAS[2], rtol=1e-6)


def parts(a: ObjectState, b: ObjectState) -> np.ndarray:
    """From one to the other: the turn in the first one's frame, all else as it is."""
    turn = gtsam.Rot3.Logmap(a.T_world_object.rotation().between(b.T_world_object.rotation()))
    move = b.T_world_object.translation() - a.T_world_object.translation()
    return np.concatenate([turn, move, b.log_scale - a.log_scale, b.code - a.code])


def along(a: ObjectState, step: np.ndarray) -> ObjectState:
    T = a.T_world_object
    R = T.rotation().compose(gtsam.Rot3.Expmap(step[:3]))
    pose = gtsam.Pose3(R, T.translation() + step[3:6])
    return ObjectState(pose, a.log_scale + step[6:9], a.code + step[9:])


def numerical(function, dims: int, step: float = 1e-6) -> np.ndarray:
    columns = [(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(dims)]
    return np.stack(columns, axis=1)


@given(heading=st.floats(-0.5, 0.5), lean=st.floats(-0.3, 0.3), away=st.floats(-0.1, 0.1))
def test_both_are_carried_by_the_derivatives(heading, lean, away):
    (state, a), (other, b) = estimate(0.2, (0.0, 0.0, 0.0)), estimate(0.2 + heading, (away, 0.05, 0.01))
    other = other.retract(np.concatenate([[lean], np.zeros(8 + CODE)]))
    size = len(SIGMAS)
    J = numerical(lambda d: parts(state, state.retract(d)), size)
    K = numerical(lambda d: parts(state, other.retract(d)), size)
    of_a, of_b = 0.3 * np.linalg.inv(J @ a.matrix @ J.T), 0.7 * np.linalg.inv(K @ b.matrix @ K.T)
    matrix = np.linalg.inv(of_a + of_b)
    step = matrix @ of_b @ parts(state, other)
    expected = along(state, step)
    back = numerical(lambda d: expected.local_coordinates(along(state, step + d)), size)
    found, covariance = fused((state, a), (other, b), 0.3)
    np.testing.assert_allclose(expected.local_coordinates(found), 0.0, atol=1e-7)
    np.testing.assert_allclose(covariance.matrix, back @ matrix @ back.T, rtol=1e-5, atol=1e-9)


def test_one_is_kept_where_the_other_knows_nothing():
    first, second = estimate(0.2, (0.0, 0.0, 0.0)), estimate(0.4, (0.1, 0.0, 0.0), 1e3 * SIGMAS)
    state, covariance = fused(first, second)
    np.testing.assert_allclose(first[0].local_coordinates(state), 0.0, atol=1e-5)
    np.testing.assert_allclose(covariance.matrix, 2 * first[1].matrix, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1, np.nan])
def test_a_share_that_is_none_is_refused(share):
    each = estimate(0.2, (0.0, 0.0, 0.0))
    with pytest.raises(CovarianceError):
        fused(each, each, share)


@pytest.mark.parametrize(
    ("heading", "centre", "sigmas"),
    [
        (np.pi, (0.0, 0.0, 0.0), SIGMAS),
        (-2.0, (0.0, 0.0, 0.0), SIGMAS),
        (0.0, (1.0, 0.0, 0.0), SIGMAS),
        (np.pi, (0.0, 0.0, 0.0), np.radians(1) * np.ones(9 + CODE)),
    ],
)
def test_estimates_that_contradict_each_other_are_not_fused(heading, centre, sigmas):
    tight = np.concatenate([np.minimum(sigmas[:6], 0.02), sigmas[6:]])
    with pytest.raises(CovarianceError, match="contradict each other"):
        fused(estimate(0.2, (0.0, 0.0, 0.0), tight), estimate(0.2 + heading, centre, tight))


def test_estimates_are_fused_as_far_apart_as_any_common_errors_allow():
    """Of errors that are each other's opposite the difference has four times one's variance, not twice."""
    rng = np.random.default_rng(0)
    for x, y, z, turn in rng.normal(size=(200, 4)) * [*SIGMAS[3:6], SIGMAS[2]]:
        fused(estimate(0.2 + turn, (x, y, z)), estimate(0.2 - turn, (-x, -y, -z)))
