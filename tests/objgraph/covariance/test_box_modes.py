"""Boxes of all headings, and what of their sets holds a box."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from objgraph.covariance.box import BOX_AXES, BoxPose
from objgraph.covariance.box_modes import HEADING_AXIS, box_modes, factor_needed, turned_axes
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import LabelledCovariance
from objgraph.estimate.heading_modes import turned
from tests.toys import toy_prior, toy_state

RADIUS = float(chi2.ppf(0.95, 9))


def covariance(seed: int = 0) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(9, 9)) * 0.02
    return root @ root.T + 1e-6 * np.eye(9)


def box_of(matrix: np.ndarray) -> BoxPose:
    state = toy_state(0.4)
    pose = gtsam.Pose3(state.T_world_object.rotation(), state.T_world_object.translation())
    return BoxPose(
        pose, np.array([0.6, 0.9, 0.4]), LabelledCovariance(matrix, BOX_AXES, "marginals", "chair 1")
    )


@pytest.mark.parametrize("quarter", range(4))
def test_turned_axes_take_a_tangent_into_the_turned_frame(quarter):
    """Against moving the box and looking at it from the turned one."""
    box, step = box_of(covariance()), 1e-6
    turn = gtsam.Pose3(gtsam.Rot3.Ry(quarter * np.pi / 2), np.zeros(3))
    axes = turned_axes(quarter)
    for tangent in np.eye(9):
        moved = box.T_world_box.retract(step * tangent[:6])
        seen = box.T_world_box.compose(turn).localCoordinates(moved.compose(turn)) / step
        extents = box.extents * np.exp(step * tangent[6:])
        edges = [
            extents[[2, 1, 0]] if quarter % 2 else extents,
            box.extents[[2, 1, 0]] if quarter % 2 else box.extents,
        ]
        expected = np.concatenate([seen, np.log(edges[0] / edges[1]) / step])
        np.testing.assert_allclose(axes @ tangent, expected, atol=1e-5)
    np.testing.assert_allclose(axes @ axes.T, np.eye(9))


def test_without_other_headings_there_is_one_mode():
    box = box_of(covariance())
    ((mode),) = box_modes(box, toy_state(0.4), None)
    assert mode.probability == 1.0
    assert mode.box is box


def test_modes_stand_where_their_states_do():
    prior, state = toy_prior(), toy_state(0.4)
    object.__setattr__(prior, "box", np.array([0.5, 0.7, 0.4]))
    states = tuple(turned(state, quarter, prior) for quarter in range(4))
    box = BoxPose(state.T_world_object, state.scale * prior.box, box_of(covariance()).covariance)
    kept = box_modes(
        box, state, HeadingModes(np.array([0.6, 0.3, 0.1, 0.0]), (state, states[1], states[2], None))
    )
    unkept = box_modes(box, state, HeadingModes(np.array([0.6, 0.3, 0.1, 0.0])))
    assert [mode.probability for mode in kept] == [0.6, 0.3, 0.1]
    for a, b, quarter in zip(kept, unkept, range(3), strict=True):
        np.testing.assert_allclose(
            a.box.T_world_box.matrix(), states[quarter].T_world_object.matrix(), atol=1e-9
        )
        np.testing.assert_allclose(b.box.T_world_box.matrix(), a.box.T_world_box.matrix(), atol=1e-9)
        np.testing.assert_allclose(a.box.extents, states[quarter].scale * prior.box)
        np.testing.assert_allclose(b.box.extents, a.box.extents)
        np.testing.assert_allclose(
            np.linalg.eigvalsh(a.box.covariance.matrix), np.linalg.eigvalsh(covariance())
        )


def test_of_one_mode_the_set_is_its_ellipsoid():
    matrix, error = covariance(), 0.05 * np.ones(9)
    squared = error @ np.linalg.solve(matrix, error)
    assert factor_needed([(1.0, error)], matrix, RADIUS) == pytest.approx(squared / RADIUS)
    heading = error[1] ** 2 / matrix[1, 1]
    assert factor_needed([(1.0, error)], matrix, 3.84, HEADING_AXIS) == pytest.approx(heading / 3.84)


@given(st.floats(1e-6, 1.0), st.floats(0.01, 3.0))
def test_the_set_of_a_mixture_is_where_one_of_its_modes_is_near(probability, far):
    """The factor is the one at which d^2 / factor - 2 log p is the radius."""
    matrix, error = covariance(), far * np.linalg.cholesky(covariance())[:, 0]
    factor = factor_needed([(1.0, 100 * error), (probability, error)], matrix, RADIUS)
    if probability <= np.exp(-RADIUS / 2):
        assert factor == pytest.approx(factor_needed([(1.0, 100 * error)], matrix, RADIUS))
    else:
        near = far**2 / factor - 2 * np.log(probability)
        assert near == pytest.approx(RADIUS) or factor == pytest.approx(100**2 * far**2 / RADIUS)


def test_the_likeliest_mode_has_a_part_at_every_level():
    error = np.full(9, 0.01)
    alone = factor_needed([(1.0, error)], covariance(), 0.1)
    assert factor_needed(
        [(0.3, error), (0.2, np.ones(9)), (0.0, np.zeros(9))], covariance(), 0.1
    ) == pytest.approx(alone)


def test_draws_of_a_mixture_lie_in_its_set_at_least_as_often_as_it_says():
    """A level of the chi-squared counts each mode's own share; the others' sets only add to it."""
    rng, matrix = np.random.default_rng(3), covariance()
    weights, offset = np.array([0.7, 0.3]), np.full(9, 0.5)
    inside = 0
    for _ in range(2000):
        at = rng.choice(2, p=weights) * offset + np.linalg.cholesky(matrix) @ rng.normal(size=9)
        inside += factor_needed([(w, at - k * offset) for k, w in enumerate(weights)], matrix, RADIUS) <= 1
    assert inside / 2000 > 0.9
