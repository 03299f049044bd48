"""Other headings in the same box: their probabilities, and what they add to a box's covariance."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.covariance.box import BoxPose, box_pose
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.errors import CovarianceError
from objgraph.metrics.box_error import box_error
from tests.toys import toy_prior, toy_state

SIZE = np.array([1.6, 0.7, 0.9])
PLACE = gtsam.Pose3(gtsam.Rot3.Rodrigues(0.1, 0.8, -0.2), np.array([1.0, -2.0, 0.5]))


def quarter(box: BoxPose, count: int) -> GroundTruth:
    """The same metric box, its axes turned by quarters."""
    turn = gtsam.Pose3(gtsam.Rot3.Ry(count * np.pi / 2), np.zeros(3))
    extents = box.extents[[2, 1, 0]] if count % 2 else box.extents
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = np.array([[0, 1, 2], [5, 6, 7], [0, 3, 5], [1, 2, 4], [2, 4, 7]])
    return GroundTruth(box.T_world_box.compose(turn).matrix(), extents, corners, faces, 1)


@pytest.mark.parametrize("count", range(4))
def test_one_turn_s_moment_is_the_square_of_the_error_that_it_makes(count):
    box = BoxPose(PLACE, SIZE, None)  # pyright: ignore[reportArgumentType]
    error = box_error(box, quarter(box, count)).tangent
    moment = HeadingModes(np.eye(4)[count]).second_moment(SIZE)
    np.testing.assert_allclose(moment, np.outer(error, error), atol=1e-9)


@given(st.lists(st.floats(0, 60), min_size=4, max_size=4), st.floats(0.5, 20), st.floats(-100, 100))
def test_probabilities_fall_with_cost_and_do_not_know_its_zero(costs, temperature, offset):
    found = HeadingModes.of_costs(np.array(costs), temperature).probability
    again = HeadingModes.of_costs(np.array(costs) + offset, temperature).probability
    np.testing.assert_allclose(found, again, rtol=1e-6, atol=1e-12)
    ratio = found[1] / max(found[0], 1e-300)
    if found[0] > 1e-12:
        assert ratio == pytest.approx(np.exp((costs[0] - costs[1]) / temperature), rel=1e-6)


def test_what_could_not_be_solved_has_no_chance():
    found = HeadingModes.of_costs(np.array([3.0, np.inf, np.nan, 3.0]), 5.0)
    np.testing.assert_allclose(found.probability, [0.5, 0, 0, 0.5])


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_states_of_some_turns_alone_are_refused(count):
    """Which of the four they are nobody could tell."""
    with pytest.raises(
        CovarianceError, match=f"states of four quarter turns were expected, or none, got {count}"
    ):
        HeadingModes(np.array([0.5, 0.0, 0.5, 0.0]), (toy_state(),) * count)


@pytest.mark.parametrize("wrong", [[1, 0, 0], [0.5, 0.2, 0.2, 0.2], [1.2, -0.2, 0, 0], [np.nan, 0, 0, 1]])
def test_what_is_no_distribution_is_refused(wrong):
    with pytest.raises(CovarianceError, match="probabilities"):
        HeadingModes(np.array(wrong))


def test_a_box_that_may_stand_the_other_way_round_is_held_both_ways():
    prior, state = replace(toy_prior(), box=np.array([0.5, 0.7, 0.4])), toy_state()
    covariance = ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals", "chair 1")
    sure = box_pose(prior, state, covariance)
    doubtful = box_pose(prior, state, covariance, turns=HeadingModes(np.array([0.6, 0.1, 0.2, 0.1])))
    for count in range(4):
        error = box_error(sure, quarter(sure, count)).tangent
        squared = [error @ np.linalg.solve(each.covariance.matrix, error) for each in (sure, doubtful)]
        assert squared[1] < 11
        assert count == 0 or squared[0] > 1000
    added = doubtful.covariance.matrix - sure.covariance.matrix
    assert np.linalg.eigvalsh(added).min() > -1e-12


def test_turns_that_are_none_are_refused():
    prior, covariance = toy_prior(), ObjectCovariance.diagonal(np.full(13, 1e-4), "marginals")
    with pytest.raises(CovarianceError, match="turns must be of type HeadingModes"):
        box_pose(prior, toy_state(), covariance, np.eye(3), turns=[0.5, 0, 0.5, 0])  # pyright: ignore[reportArgumentType]


def test_states_are_told_apart_by_the_nearest_quarter_of_the_estimate():
    """Of two at one turn the cheaper counts; what stands as the estimate does is the estimate's own heading."""
    angles = (0.3, 0.3 + np.pi / 2 + 0.2, 0.3 + np.pi / 2 - 0.2, 0.3 - np.pi / 2)
    states = [
        replace(toy_state(), T_world_object=PLACE.compose(gtsam.Pose3(gtsam.Rot3.Ry(angle), np.zeros(3))))
        for angle in angles
    ]
    found = HeadingModes.of_states(states, np.array([1.0, 4.0, 2.0, 3.0]), 0, 1.0)
    weight = np.exp(-np.array([1.0, 2.0, np.inf, 3.0]))
    np.testing.assert_allclose(found.probability, weight / weight.sum())
    assert found.states[0] is states[0]
    assert found.states[1] is states[2]
    assert found.states[2] is None
    assert found.states[3] is states[3]
