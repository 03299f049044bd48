"""Problems that fail: each for itself, at whatever step, with the last good values."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from factors.reduce import guarded_factor
from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.graph.solve import Problem, minimize, solve
from tests.objgraph.graph.graph_cases import empty, pose_noise, views_of
from tests.objgraph.graph.solve_cases import SHORT, TIGHT, chair_problem, difference, pose_graph
from tests.toys import ToyDecoder, toy_prior, toy_state


class FragileDecoder(ToyDecoder):
    """Answers NaN once `broken` is set."""

    broken = False

    def _network(self, points, injected):
        return super()._network(points, injected) * (np.nan if self.broken else 1.0)


def nan_decoder() -> Problem:
    decoder = FragileDecoder().double()
    decoder.broken = True
    return chair_problem(1.0, decoder)


class RaisingDecoder(ToyDecoder):
    """Can be asked so often and then no more."""

    left = 0

    def _network(self, points, injected):
        self.left -= 1
        if self.left < 0:
            raise RuntimeError("this decoder is broken")
        return super()._network(points, injected)


def raising_decoder(left: int = 0) -> Problem:
    decoder = RaisingDecoder().double()
    decoder.left = left
    return chair_problem(1.0, decoder)


def nan_measurement() -> Problem:
    return pose_graph(measured=np.nan)


def missing_value() -> Problem:
    problem = pose_graph()
    problem.values.erase(X(2))
    return problem


def nan_state() -> Problem:
    problem = chair_problem(1.0)
    problem.values.update(ObjectKeys.numbered(0).code, np.full(4, np.nan))
    return problem


@pytest.mark.parametrize("bad", [nan_decoder, raising_decoder, nan_measurement, missing_value, nan_state])
def test_a_failing_problem_leaves_the_others_alone(bad):
    alone, beside, failing = chair_problem(), chair_problem(), bad()
    solve([alone], SHORT)
    solve([failing, beside, pose_graph()], SHORT)
    assert failing.failure
    assert beside.failure is None
    assert beside.cost == pytest.approx(alone.cost, rel=1e-9)
    assert difference(beside.values, alone.values) < 1e-9


@pytest.mark.parametrize("left", range(1, 34, 2))
def test_a_decoder_that_raises_on_the_way_stops_its_own_problem_alone(left):
    """Wherever it happens: while samples are drawn, or where all problems decode together."""
    alone, beside, failing = chair_problem(), chair_problem(), raising_decoder(left)
    solve([alone], SHORT)
    solve([failing, beside], SHORT)
    assert failing.failure == "this decoder is broken"
    assert beside.failure is None
    assert beside.cost == pytest.approx(alone.cost, rel=1e-9)


@pytest.mark.parametrize("bad", [nan_decoder, nan_measurement, missing_value])
def test_minimize_raises_and_names_the_problem(bad):
    problem = bad()
    with pytest.raises(SolveError, match=problem.name):
        minimize(problem)


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_after_a_late_failure_the_last_good_values_stand(rounds):
    """A decoder that breaks on the way stops its own object, whichever round it is in."""
    decoder = FragileDecoder().double()
    problem, beside, alone = chair_problem(decoder=decoder), chair_problem(2.0), chair_problem(2.0)
    problem.refresh(200.0)
    start = problem.graph.error(problem.values)

    def breaks(done, _):
        decoder.broken = done >= rounds

    solve([problem, beside], SHORT, breaks)
    solve([alone], SHORT)
    assert problem.failure
    assert beside.failure is None
    assert beside.cost == pytest.approx(alone.cost, rel=1e-9)
    decoder.broken = False
    problem.refresh(200.0)
    assert problem.graph.error(problem.values) < 0.7 * start


def test_a_part_that_fails_stays_as_it_was_in_the_caller_s_values():
    """Coarse slopes have moved it by then, away from where it was best."""
    decoder, state = FragileDecoder().double(), toy_state()
    objects = empty()
    handle = objects.add_object(replace(toy_prior(), decoder=decoder), state)
    for view in views_of(state):
        objects.observe(handle, view)
    objects.values.insert(L(0), np.ones(1))
    objects.graph.push_back(gtsam.PriorFactorVector(L(0), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))

    def breaks(done, _):
        decoder.broken = done >= 1

    with pytest.raises(SolveError, match=r"chair 0: .*not finite"):
        objects.optimize(SHORT, breaks)
    assert objects.state(handle).T_world_object.equals(state.T_world_object, 0.0)
    np.testing.assert_array_equal(objects.state(handle).code, state.code)
    assert objects.values.atVector(L(0))[0] == pytest.approx(0.0, abs=1e-3)


def test_an_error_without_words_is_a_failure_too():
    objects = empty()
    handle = objects.add_object(toy_prior(), toy_state())
    pose = gtsam.PriorFactorPose3(handle.keys.pose, toy_state().T_world_object, pose_noise(0.1, 0.1))
    objects.graph.push_back(pose)

    def fails(this, values, H):
        raise ValueError

    objects.graph.push_back(gtsam.CustomFactor(pose_noise(1, 1), gtsam.KeyVector([handle.keys.pose]), fails))
    with pytest.raises(SolveError, match="chair 0: ValueError"):
        objects.optimize(SHORT)


def logarithm() -> Problem:
    """One number of which the logarithm is measured: the first full step leads to where there is none."""
    key, graph, values = L(0), gtsam.NonlinearFactorGraph(), gtsam.Values()

    def evaluate(values: gtsam.Values, jacobian: bool):
        (x,) = values.atVector(key)
        with np.errstate(invalid="ignore"):
            residual = np.array([np.log(x) - np.log(0.01)])
        return residual, [np.array([[1 / x]])] if jacobian else None

    graph.push_back(guarded_factor([key], [1], 1, evaluate, "Logarithm"))
    values.insert(key, np.array([3.0]))
    return Problem("logarithm", graph, values, [])


def test_a_step_to_where_nothing_is_finite_is_taken_back_and_a_shorter_one_is_tried():
    problem = logarithm()
    minimize(problem, TIGHT)
    assert problem.failure is None
    assert problem.values.atVector(L(0))[0] == pytest.approx(0.01)
