"""The lockstep Levenberg-Marquardt: GTSAM's own minima, each problem for itself, rounds and what is kept of them."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import X

from factors.state import ObjectKeys, ObjectState
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, SolverConfig, minimize, solve
from tests.objgraph.graph.solve_cases import (
    SHORT,
    TIGHT,
    chair_problem,
    difference,
    egg_problem,
    pose_graph,
)
from tests.toys import ToyDecoder


def stock(problem: Problem) -> gtsam.Values:
    """GTSAM's own Levenberg-Marquardt from the same start."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(200)
    parameters.setRelativeErrorTol(1e-10)
    parameters.setAbsoluteErrorTol(1e-12)
    return gtsam.LevenbergMarquardtOptimizer(problem.graph, problem.values, parameters).optimize()


@pytest.mark.parametrize("make", [egg_problem, pose_graph])
def test_the_minimum_is_the_stock_optimiser_s(make):
    problem = make()
    expected = stock(problem)
    before = problem.graph.error(problem.values)
    minimize(problem, TIGHT)
    assert problem.cost_initial == pytest.approx(before)
    assert problem.cost == pytest.approx(problem.graph.error(problem.values))
    assert problem.cost == pytest.approx(problem.graph.error(expected), rel=1e-6)
    assert problem.cost < 0.5 * before
    assert difference(problem.values, expected) < 1e-4
    # it stops by itself, long before the limit
    assert problem.linearizations < 60


@pytest.mark.parametrize("false_loops", [100, 300])
def test_robust_noise_of_the_caller_s_is_no_hindrance(false_loops):
    """A quadratic's own value is then less than the cost: what a step promises is told by the quadratic alone."""
    rng, graph, values = np.random.default_rng(0), gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.02, 0.05], 3))
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.345), noise)
    step = gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.array([0.9, 0.1, 0.0]))
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
    for k in range(20):
        values.insert(
            X(k), gtsam.Pose3.Expmap(k * gtsam.Pose3.Logmap(step)).retract(0.1 * rng.normal(size=6))
        )
        if k:
            graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), step, noise))
    for _ in range(false_loops):
        i, j = sorted(rng.choice(20, 2, replace=False).tolist())
        wrong = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), 3 * rng.normal(size=3))
        graph.push_back(gtsam.BetweenFactorPose3(X(i), X(j), wrong, robust))
    problem = Problem("ring", graph, values, [])
    expected = graph.error(stock(problem))
    solve([problem], SolverConfig(rounds=20))
    assert problem.cost < expected * (1 + 1e-3)


def test_the_frozen_chair_is_solved_as_well_as_by_the_stock_optimiser():
    """Boxes have edges, so the two stop in places a millimetre apart: the cost must not be higher."""
    problem = chair_problem()
    problem.refresh(120.0)
    expected = stock(problem)
    minimize(problem, TIGHT)
    assert problem.cost <= problem.graph.error(expected) * (1 + 1e-3)
    assert problem.cost < 0.5 * problem.cost_initial
    T, T_stock = problem.values.atPose3(gtsam.symbol("o", 0)), expected.atPose3(gtsam.symbol("o", 0))
    assert np.abs(gtsam.Pose3.Logmap(T.between(T_stock))).max() < 5e-3


@pytest.mark.parametrize("make", [egg_problem, pose_graph])
def test_a_step_is_marquardt_s(make):
    """(H + damping diag H) step = -gradient, whatever the sizes and the order of the variables."""
    problem = make()
    start, damping = gtsam.Values(problem.values), 0.3
    H, negative_gradient = problem.graph.linearize(start).hessian()
    expected = np.linalg.solve(H + damping * np.diag(np.diag(H)), negative_gradient)
    minimize(problem, LevenbergMarquardtConfig(iterations=1, initial_damping=damping))
    step = start.localCoordinates(problem.values)
    np.testing.assert_allclose(
        np.concatenate([step.at(key) for key in sorted(start.keys())]), expected, rtol=1e-5
    )


@pytest.mark.parametrize("make", [egg_problem, pose_graph, chair_problem])
def test_the_cost_never_rises(make):
    costs = []
    for iterations in range(9):
        problem = make()
        problem.refresh(120.0)
        minimize(problem, LevenbergMarquardtConfig(iterations, relative_tolerance=0.0))
        costs.append(problem.cost)
        assert problem.cost <= problem.cost_initial
        assert problem.cost == pytest.approx(problem.graph.error(problem.values))
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < costs[0]


def test_constrained_noise_is_obeyed():
    problem = pose_graph(prior=False)
    problem.graph.push_back(gtsam.NonlinearEqualityPose3(X(0), problem.values.atPose3(X(0))))
    held = problem.values.atPose3(X(0))
    minimize(problem, TIGHT)
    assert problem.values.atPose3(X(0)).equals(held, 1e-9)
    assert problem.cost < 0.5 * problem.cost_initial


def test_in_lockstep_each_is_solved_as_if_alone():
    def make():
        shared = ToyDecoder().double()
        return [chair_problem(0.4, shared), pose_graph(), chair_problem(2.0, shared)]

    together, alone = make(), make()
    solve(together, SHORT)
    for problem in alone:
        solve([problem], SHORT)
    for a, b in zip(together, alone, strict=True):
        assert a.cost == pytest.approx(b.cost, rel=1e-6)
        assert difference(a.values, b.values) < 1e-6
        assert (a.linearizations, a.error_evaluations) == (b.linearizations, b.error_evaluations)
        assert a.failure is None


@pytest.mark.parametrize("seed", range(6))
def test_what_is_frozen_is_that_of_the_values(seed):
    """Whichever round was best, the graph's cost and marginals are those of what `solve` reports."""
    problem = chair_problem()
    rng = np.random.default_rng(seed)
    state = ObjectState.from_values(problem.values, ObjectKeys.numbered(0))
    state.retract(0.05 * rng.normal(size=13)).update(problem.values, ObjectKeys.numbered(0))
    solve([problem], SolverConfig(slopes=(200.0,), rounds=4, relative_tolerance=-1e9))
    assert problem.graph.error(problem.values) == pytest.approx(problem.cost, rel=1e-9)
    problem.refresh(200.0)
    assert problem.graph.error(problem.values) == pytest.approx(problem.cost, rel=1e-9)


def test_an_undetermined_problem_is_solved_as_far_as_it_goes():
    free, determined = pose_graph(prior=False), pose_graph()
    solve([free, determined])
    assert free.failure is None
    assert free.cost < 0.5 * free.cost_initial
    assert free.cost <= determined.cost * (1 + 1e-6)


class Recorded(Problem):
    """A problem that remembers its slope and its cost after every refresh."""

    refreshed: list[tuple[float, float]]

    def refresh(self, slope):
        super().refresh(slope)
        self.refreshed.append((slope, self.graph.error(self.values)))

    @classmethod
    def of(cls, problem: Problem) -> "Recorded":
        recorded = cls(problem.name, problem.graph, problem.values, problem.factors)
        recorded.refreshed = []
        return recorded


def test_rounds_follow_the_slopes_and_keep_the_lowest_refreshed_cost():
    problem, told = Recorded.of(chair_problem()), []
    problem.refresh(200.0)
    (_, start), problem.refreshed = problem.refreshed[0], []
    config = SolverConfig(slopes=(60.0, 120.0, 200.0), rounds=6, inner=LevenbergMarquardtConfig(iterations=2))
    solve([problem], config, lambda done, total: told.append((done, total)))
    slopes = [slope for slope, _ in problem.refreshed]
    assert slopes[:4] == [200.0, 60.0, 120.0, 200.0]  # first what the start costs
    assert set(slopes[4:]) == {200.0}
    assert problem.cost_initial == pytest.approx(start)
    assert told == [(i + 1, 6) for i in range(len(told))]
    assert 3 <= len(told) <= 6
    problem.refresh(200.0)
    assert problem.refreshed[-1][1] == pytest.approx(problem.cost, rel=1e-6)
    assert problem.cost < 0.5 * start


def test_no_start_is_made_worse():
    """Coarse rounds can lead away from a minimum of the last slope; then the start is kept."""
    problem = chair_problem()
    solve([problem], SolverConfig(slopes=(400.0,), rounds=12, relative_tolerance=1e-9))
    again = Problem(problem.name, problem.graph, gtsam.Values(problem.values), problem.factors)
    solve([again], SolverConfig(slopes=(5.0, 400.0), rounds=2, inner=LevenbergMarquardtConfig(iterations=3)))
    assert again.cost <= again.cost_initial == pytest.approx(problem.cost, rel=1e-9)


def test_a_start_that_coarse_rounds_lead_away_from_is_solved_at_the_last_slope():
    problem = chair_problem()
    solve([problem], SolverConfig(slopes=(400.0,), rounds=1, inner=LevenbergMarquardtConfig(iterations=3)))
    away, alone = (
        Problem(problem.name, problem.graph, gtsam.Values(problem.values), problem.factors) for _ in range(2)
    )
    few = SolverConfig(slopes=(2.0, 400.0), rounds=1)
    solve([away], few)
    solve([alone], replace(few, slopes=(400.0,)))
    assert away.cost < 0.99 * away.cost_initial  # or this start would show nothing
    assert away.cost == pytest.approx(alone.cost, rel=1e-9)


def test_rounds_stop_where_nothing_is_gained():
    problem, told = pose_graph(), []
    solve([problem], SolverConfig(slopes=(60.0,), rounds=50), lambda done, _: told.append(done))
    assert len(told) < 10


def test_a_worse_last_round_is_not_kept():
    """A refresh may raise the cost; what is returned is the best of the last slope, not the last."""
    problem = Recorded.of(chair_problem())
    solve([problem], SolverConfig(slopes=(200.0,), rounds=5, relative_tolerance=-1e9))
    *costs, settled = [cost for _, cost in problem.refreshed]
    assert len(costs) > 3
    assert settled == pytest.approx(min(costs), rel=1e-9)
    assert min(costs) < costs[-1]  # or this start would show nothing
    assert problem.cost == pytest.approx(min(costs), rel=1e-9)
    problem.refresh(200.0)
    assert problem.refreshed[-1][1] == pytest.approx(min(costs), rel=1e-9)


@pytest.mark.parametrize("run", [solve, minimize])
def test_torch_has_one_thread_meanwhile(run):
    """And as many as before afterwards: what is found depends on none."""
    problem, seen = egg_problem(), []
    problem.watch = lambda _: seen.append(torch.get_num_threads())
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        run([problem] if run is solve else problem)
        assert set(seen) == {1}
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
