"""Headings beside the one that was found."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from objgraph.estimate import graph as graph_estimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.heading_modes import HeadingModesConfig, Turned, heading_modes, turned
from objgraph.estimate.task import Estimate
from objgraph.graph.builder import DetectedBox, GraphConfig
from objgraph.graph.solve import SolverConfig
from tests.objgraph.estimate.adam_cases import OFF, pose_error, task
from tests.toys import toy_mesh, toy_prior, toy_state

TRUE = toy_state(0.4)
PRIOR = replace(toy_prior(), box=np.asarray(toy_mesh(TRUE.code).extents))
EVERY = HeadingModesConfig(reach=1e6)
ANOTHER = DetectedBox(TRUE.T_world_object, TRUE.scale * PRIOR.box, 0.1, 0.1, 0.1)


@pytest.mark.parametrize("quarter", range(5))
def test_a_turned_object_fills_the_same_metric_box(quarter):
    found = turned(TRUE, quarter, PRIOR)
    T, here = found.T_world_object, TRUE.T_world_object
    assert here.translation() == pytest.approx(T.translation())
    axes = np.abs(here.rotation().matrix().T @ T.rotation().matrix()).round(9)
    np.testing.assert_allclose(axes @ (found.scale * PRIOR.box), TRUE.scale * PRIOR.box, rtol=1e-9)
    assert here.rotation().matrix()[:, 1] == pytest.approx(T.rotation().matrix()[:, 1])
    if quarter == 4:
        assert T.equals(here, 1e-9)


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_a_chair_that_was_found_the_wrong_way_round_is_turned(quarter):
    begun = turned(TRUE.retract(OFF), quarter, PRIOR)
    given = replace(task(starts=(begun,)), prior=PRIOR)
    alone = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=None).estimate([given])[0]
    found = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=EVERY).estimate([given])[0]
    assert isinstance(alone, Estimate)
    assert isinstance(found, Estimate)
    turn = alone.state.T_world_object.rotation().between(TRUE.T_world_object.rotation())
    assert np.linalg.norm(gtsam.Rot3.Logmap(turn)) > 1
    assert pose_error(found.state) < 0.03
    assert found.cost_final < alone.cost_final
    assert found.linearizations > alone.linearizations
    assert alone.turns is None
    assert found.turns is not None
    assert found.turns.probability[0] > 0.99
    own, was = found.turns.states[0], found.turns.states[quarter]
    assert own is not None
    assert was is not None
    for state, there in ((own, found.state), (was, alone.state)):
        turn = state.T_world_object.rotation().between(there.T_world_object.rotation())
        assert np.linalg.norm(gtsam.Rot3.Logmap(turn)) < 0.2


def test_a_turn_that_is_cheaper_by_chance_is_not_taken():
    """By less than the temperature: of the same two costs a larger temperature makes one of chance."""
    given = replace(task(starts=(turned(TRUE.retract(OFF), 2, PRIOR),)), prior=PRIOR)
    plain = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=None).estimate([given])[0]
    unsure = replace(EVERY, temperature=1e6)
    found = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=unsure).estimate([given])[0]
    assert isinstance(found, Estimate)
    assert isinstance(plain, Estimate)
    np.testing.assert_array_equal(found.state.code, plain.state.code)
    assert found.turns is not None
    np.testing.assert_allclose(found.turns.probability, 0.25, atol=1e-3)


def test_a_chair_that_stands_right_stays():
    given = replace(task(starts=(TRUE.retract(OFF),)), prior=PRIOR)
    found = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=EVERY).estimate([given])[0]
    plain = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=None).estimate([given])[0]
    assert isinstance(found, Estimate)
    assert isinstance(plain, Estimate)
    np.testing.assert_array_equal(found.state.code, plain.state.code)
    np.testing.assert_array_equal(found.state.scale, plain.state.scale)
    assert found.turns is not None
    assert found.turns.probability[0] > 0.99


def test_what_has_no_chance_is_not_solved():
    given = replace(task(starts=(TRUE,)), prior=PRIOR)
    assert heading_modes([given], [TRUE], GraphConfig(), HeadingModesConfig(reach=0.5)) == [None]
    # nor what has no common box, nor what a detector has said the heading of
    others = [replace(given, prior=toy_prior()), replace(given, box=ANOTHER)]
    assert heading_modes(others, [TRUE, TRUE], GraphConfig(), EVERY) == [None, None]


def test_a_turn_that_is_cheaper_on_few_points_alone_is_not_taken(monkeypatch):
    given = replace(task(starts=(TRUE.retract(OFF),)), prior=PRIOR)

    def misled(tasks, estimates, graph, config):
        back = turned(estimates[0], 2, PRIOR)
        return [Turned(np.array([5.0, np.inf, 0.0, np.inf]), (estimates[0], None, back, None), 7, 9)]

    monkeypatch.setattr(graph_estimator, "heading_modes", misled)
    plain = GraphEstimator(solver=SolverConfig(rounds=3), heading_modes=None).estimate([given])[0]
    found = GraphEstimator(solver=SolverConfig(rounds=3)).estimate([given])[0]
    assert isinstance(found, Estimate)
    assert isinstance(plain, Estimate)
    np.testing.assert_array_equal(found.state.code, plain.state.code)
    assert found.turns is not None
    np.testing.assert_allclose(found.turns.probability, [1 / (1 + np.e), 0, np.e / (1 + np.e), 0])
    assert found.linearizations > plain.linearizations + 7


def test_an_estimate_that_came_to_lean_is_not_turned_and_stops_no_other():
    given = replace(task(starts=(TRUE,)), prior=PRIOR)
    lean = gtsam.Pose3(gtsam.Rot3.Rx(np.radians(80)), np.zeros(3))
    leaning = replace(TRUE, T_world_object=TRUE.T_world_object.compose(lean))
    quick = replace(EVERY, solver=SolverConfig(slopes=(60.0,), rounds=1))
    one, other = heading_modes([given, given], [leaning, TRUE], GraphConfig(), quick)
    assert one is None
    assert other is not None
