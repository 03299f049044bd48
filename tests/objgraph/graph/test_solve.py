"""The lockstep Levenberg-Marquardt: GTSAM's own minima, each problem for itself, and failures that stay where they are."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import L, X

from factors.base import Annealing
from factors.priors import code_prior, scale_prior, upright_prior
from factors.reduce import guarded_factor
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from objgraph.errors import SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, SolverConfig, minimize, solve
from objgraph.observation.sampling import SamplingConfig, observe
from tests.toys import TOY_CODE, ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
OFF = np.array([0.05, -0.08, 0.03, 0.02, -0.03, 0.02, 0.05, -0.05, 0.03, -0.3, 0.3, -0.2, 0.1])
"""A start: degrees, centimetres and some code away from the truth."""
TIGHT = LevenbergMarquardtConfig(iterations=200, relative_tolerance=1e-10)
SHORT = SolverConfig(slopes=(60.0, 200.0), rounds=4, inner=LevenbergMarquardtConfig(iterations=3))


class EggDecoder(ToyDecoder):
    """An ellipsoid: smooth, so that two solvers must meet in one point."""

    def _network(self, points, injected):
        code = injected["0"]
        stretched = points * (1 + 0.1 * code[:, :3]) * torch.tensor([1.0, 0.7, 1.4], dtype=points.dtype)
        return (stretched.square().sum(dim=1) + 1e-6).sqrt() - 0.3 - 0.02 * code[:, 3]


class FragileDecoder(ToyDecoder):
    """Answers NaN once `broken` is set."""

    broken = False

    def _network(self, points, injected):
        return super()._network(points, injected) * (np.nan if self.broken else 1.0)


def egg_problem() -> Problem:
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    state = ObjectState(gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.zeros(3)), np.zeros(3), np.zeros(4))
    points = state.to_world(0.3 * direction / [1.0, 0.7, 1.4]) + rng.normal(size=(300, 3)) * 0.003
    keys, graph, values = ObjectKeys.numbered(0), gtsam.NonlinearFactorGraph(), gtsam.Values()
    factor = SurfaceFactor(keys, EggDecoder().double(), gtsam.Pose3(), points, np.full(300, 0.003))
    for part in (
        factor.gtsam_factor(),
        code_prior(keys, np.zeros(4), np.eye(4)),
        scale_prior(keys, 0.0, 0.3, 0.1),
        upright_prior(keys, UP, 0.03),
    ):
        graph.push_back(part)
    state.retract(OFF).insert(values, keys)
    factor.refresh(values, Annealing())
    return Problem("egg", graph, values, [factor])


def pose_graph(measured: float = 1.0, prior: bool = True) -> Problem:
    """A square of poses that closes badly, with a landmark seen from two corners."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    if prior:
        graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), noise))
    corner = gtsam.Pose3(gtsam.Rot3.Rz(np.pi / 2), np.array([measured, 0.05, -0.02]))
    for i in range(4):
        graph.push_back(gtsam.BetweenFactorPose3(X(i), X((i + 1) % 4), corner, noise))
        values.insert(
            X(i), gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 1.4 * i), np.array([0.3 * i, 0.5, -0.2]))
        )
    sight = gtsam.noiseModel.Diagonal.Sigmas([0.01, 0.02, 0.05])
    for i in (0, 2):
        bearing = gtsam.Unit3(np.array([1.0, 0.4, 0.2]))
        graph.push_back(gtsam.BearingRangeFactor3D(X(i), L(0), bearing, 0.8, sight))
    values.insert(L(0), np.array([0.7, 0.6, 0.1]))
    return Problem("square", graph, values, [])


def chair_problem(heading: float = 0.4, decoder: ToyDecoder | None = None) -> Problem:
    state, sampling = toy_state(heading), SamplingConfig(points=80, hits=40, free=40)
    views = [
        observe(toy_frame([state], azimuth, seed=i), 1, sampling) for i, azimuth in enumerate((0.3, 2.0))
    ]
    wide = 4.5 * np.eye(TOY_CODE)
    prior = replace(toy_prior(), decoder=decoder or ToyDecoder().double(), code_covariance=wide)
    return ObjectBuilder(up_world=UP).alone(prior, state.retract(OFF), views)


def difference(a: gtsam.Values, b: gtsam.Values) -> float:
    delta = a.localCoordinates(b)
    return max(np.abs(delta.at(key)).max() for key in list(a.keys()))


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


@pytest.mark.parametrize("left", range(1, 40, 2))
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
    solve([problem], SolverConfig(slopes=(400.0,), rounds=1, inner=LevenbergMarquardtConfig(iterations=2)))
    away, alone = (
        Problem(problem.name, problem.graph, gtsam.Values(problem.values), problem.factors) for _ in range(2)
    )
    few = SolverConfig(slopes=(5.0, 400.0), rounds=1)
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
