"""Levenberg-Marquardt on GTSAM graphs, many independent ones in lockstep.

Objects that share no unknown variable are independent: each has its own damping and stops by itself, but all
decode together, in one call of the network a step. Damping follows the gain ratio (Nielsen, "Damping parameter in
Marquardt's method", 1999).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np

from factors import checks
from factors.base import SLOPES, Annealing, ObservationFactor
from factors.batch import decode
from factors.errors import NotFiniteError
from factors.sdf import SdfQuery
from objgraph.diagnostics.linear import hessian_diagonal
from objgraph.diagnostics.undetermined import check_linear
from objgraph.errors import ConfigError, ObjectGraphError, SolveError
from objgraph.work import torch_threads

FAILURES = (ObjectGraphError, RuntimeError, ValueError)
"""Of one object, which must not take others along: ours, and a decoder's and GTSAM's own, which are RuntimeErrors."""


@dataclass(frozen=True)
class LevenbergMarquardtConfig:
    """One minimisation with everything frozen."""

    iterations: int = 6
    """Accepted and rejected steps at most."""
    initial_damping: float = 1e-3
    """Relative to the Hessian's diagonal."""
    relative_tolerance: float = 1e-3
    """Stop where an accepted step lowers the cost by less than this share of it."""
    absolute_tolerance: float = 0.2
    """... and by less than this: the cost of many objects is large wherever they are."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, iterations=checks.Range(0, 10_000), initial_damping=checks.POSITIVE
        )


@dataclass(frozen=True)
class SolverConfig:
    """Freeze, solve, refresh."""

    slopes: tuple[float, ...] = (60.0, 120.0, 400.0)
    """Occupancy slopes (1/metres) of the rounds; the last one is repeated."""
    rounds: int = 5
    """Rounds at most."""
    relative_tolerance: float = 5e-3
    """Stop at the last slope where a round lowers the refreshed cost by less than this share of it."""
    absolute_tolerance: float = 1.0
    """... and by less than this, in units of the cost: half a squared standard deviation."""
    inner: LevenbergMarquardtConfig = field(default_factory=LevenbergMarquardtConfig)

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind, or there is no slope."""
        checks.settings(
            self, ConfigError, slopes=SLOPES, rounds=checks.Range(0, 1000), relative_tolerance=checks.ANY
        )
        if not self.slopes:
            raise ConfigError("SolverConfig.slopes is empty: at least one is due")


@dataclass
class Problem:
    """One connected set of unknowns: a graph, its current estimate, and what was spent on it."""

    name: str
    """Whom an error message should name."""
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    factors: Sequence[ObservationFactor]
    """Those of the graph's factors that use a decoder."""
    cost_initial: float = np.nan
    """Where the solver began; `solve` refreshes it at its last slope, so that `cost` can be compared with it."""
    cost: float = np.nan
    linearizations: int = 0
    error_evaluations: int = 0
    damping: float = 0.0
    """What the last accepted step left; the next minimisation does not begin below."""
    failure: str | None = None
    """Why it was given up; the values are then the last good ones."""
    watch: Callable[["Problem"], None] | None = None
    """Called with it after each accepted step."""

    def refresh(self, slope: float) -> None:
        for factor in self.factors:
            factor.refresh(self.values, Annealing(slope))

    def settle(self, slope: float) -> None:
        """Freeze what belongs to the values, and say what they cost with it: marginals are then of what is reported."""
        self.cost = self.refreshed_cost(slope)

    def refreshed_cost(self, slope: float) -> float:
        """The cost of the current estimate with samples and weights of its own."""
        self.refresh(slope)
        self.error_evaluations += 1
        return self.graph.error(self.values)

    def cost_at(self, trial: gtsam.Values) -> float:
        """The cost after a step, with everything frozen as it is; infinite where the step was so long that there is none."""
        self.error_evaluations += 1
        try:
            return self.graph.error(trial)
        except NotFiniteError:
            return np.inf


@torch_threads(1)
def solve(
    problems: Sequence[Problem],
    config: SolverConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    refuse_undetermined: bool = False,
) -> None:
    """Minimise every problem in place, freezing and refreshing along the slopes.

    A problem that fails gets its `failure` set and leaves the others alone. The values kept are those of the lowest
    refreshed cost at the last slope, the start among them. `progress` is called with (rounds done, rounds at most).
    Damping finds a minimum of a problem that leaves something undetermined too, and says nothing of it; with
    `refuse_undetermined` such a problem fails before it is moved, and its failure names what is missing.
    It works in one thread, whatever torch has: more hardly help, and where others work they wait for each other.
    """
    config = checks.settings_or_default(config, SolverConfig, ConfigError)
    last = config.slopes[-1]
    active = [problem for problem in problems if _guarded(problem, lambda p: _begin(p, last))]
    starts = {id(problem): gtsam.Values(problem.values) for problem in active}
    best: dict[int, tuple[float, gtsam.Values]] = {}
    for round_index in range(config.rounds):
        slope = config.slopes[min(round_index, len(config.slopes) - 1)]
        active = [problem for problem in active if _guarded(problem, lambda p, s=slope: p.refresh(s))]
        if round_index >= len(config.slopes):
            active = [p for p in active if _still_falling(p, best, config)]
        active = _levenberg_marquardt(active, config.inner, refuse_undetermined and round_index == 0)
        if progress is not None:
            progress(round_index + 1, config.rounds)
        if not active:
            break
    for problem in active:
        if _guarded(problem, lambda p: p.refresh(last)):
            _still_falling(problem, best, config)
    unmoved: list[Problem] = []
    for problem in problems:
        if id(problem) in best:
            start = (problem.cost_initial, starts[id(problem)])
            problem.cost, problem.values = min(best[id(problem)], start, key=lambda each: each[0])
            if len(config.slopes) > 1 and problem.values is start[1]:
                unmoved.append(problem)
            else:
                _guarded(problem, lambda p: p.settle(last))
    if unmoved:  # the coarse slopes led away from a start that is better: it is no minimum yet
        solve(unmoved, replace(config, slopes=(last,)))


def _begin(problem: Problem, slope: float) -> None:
    problem.cost_initial = problem.refreshed_cost(slope)
    if not np.isfinite(problem.cost_initial):
        raise SolveError(f"the cost at the start is {problem.cost_initial}")


def _still_falling(
    problem: Problem, best: dict[int, tuple[float, gtsam.Values]], config: SolverConfig
) -> bool:
    """Keep the refreshed problem's values if they are its best so far, and say whether they were much better."""
    costs: list[float] = []
    if not _guarded(problem, lambda p: costs.append(p.graph.error(p.values))):
        return False
    (cost,) = costs
    before = best.get(id(problem), (np.inf, problem.values))[0]
    if cost < before:
        best[id(problem)] = (cost, gtsam.Values(problem.values))
    return before - cost > min(config.relative_tolerance * cost, config.absolute_tolerance)


@torch_threads(1)
def minimize(problem: Problem, config: LevenbergMarquardtConfig | None = None) -> None:
    """One Levenberg-Marquardt run with everything frozen as it is; raises SolveError where it fails."""
    if _guarded(problem, _start):
        problem.cost_initial = problem.cost
        config = checks.settings_or_default(config, LevenbergMarquardtConfig, ConfigError)
        _levenberg_marquardt([problem], config)
    if problem.failure is not None:
        raise SolveError(f"{problem.name}: {problem.failure}")


@dataclass
class _Step:
    problem: Problem
    damping: float
    growth: float = 2.0
    linear: gtsam.GaussianFactorGraph | None = None
    trial: gtsam.Values | None = None
    predicted: float = 0.0
    done: bool = False
    unchecked: bool = False
    """Whether to refuse the problem if its first linearisation is singular."""


def _levenberg_marquardt(
    problems: Sequence[Problem], config: LevenbergMarquardtConfig, check: bool = False
) -> list[Problem]:
    steps = [_Step(p, max(config.initial_damping, p.damping), unchecked=check) for p in problems]
    _decode(steps, jacobian=False)
    for step in steps:
        step.done = not _guarded(step.problem, _start)
    for _ in range(config.iterations):
        _decode([step for step in steps if not step.done and step.linear is None], jacobian=True)
        running = [step for step in steps if not step.done]
        for step in running:
            step.done = not _guarded(step.problem, lambda _, s=step: _propose(s))
        running = [step for step in running if not step.done]
        if not running:
            break
        _decode(running, jacobian=False)
        for step in running:
            judged = _guarded(step.problem, lambda _, s=step: _judge(s, config))
            step.done = step.done or not judged
    return [problem for problem in problems if problem.failure is None]


def _decode(steps: Sequence[_Step], jacobian: bool) -> None:
    """What trials ask for, and where there is none, what the estimate does."""
    queries: list[list[tuple[ObservationFactor, SdfQuery]]] = []
    asking: list[Problem] = []
    for step in steps:
        if step.problem.failure is None:
            values = step.problem.values if step.trial is None else step.trial
            asked = _guarded(
                step.problem, lambda p, v=values: queries.append([(f, f.query(v)) for f in p.factors])
            )
            asking += [step.problem] * asked
    try:
        decode([query for each in queries for query in each], jacobian)
    except FAILURES:  # one of them fails, and alone
        for problem, own in zip(asking, queries, strict=True):
            _guarded(problem, lambda _, q=own: decode(q, jacobian))


def _start(problem: Problem) -> None:
    problem.cost = problem.graph.error(problem.values)
    problem.error_evaluations += 1
    if not np.isfinite(problem.cost):
        raise SolveError(f"the cost at the start is {problem.cost}")


def _propose(step: _Step) -> None:
    problem = step.problem
    if step.linear is None:
        step.linear = problem.graph.linearize(problem.values)
        problem.linearizations += 1
    if step.unchecked:
        check_linear(step.linear, problem.values, {factor.object_keys for factor in problem.factors})
        step.unchecked = False
    delta = _damped(step.linear, step.damping).optimize()
    # not the cost: robust noise of the caller's makes that larger than the quadratic's value
    step.predicted = step.linear.error(delta.scale(0.0)) - step.linear.error(delta)
    step.trial = problem.values.retract(delta)


def _judge(step: _Step, config: LevenbergMarquardtConfig) -> None:
    problem = step.problem
    assert step.trial is not None
    cost = problem.cost_at(step.trial)
    # capped: where next to nothing was predicted the ratio is that of rounding errors
    gain = min((problem.cost - cost) / max(step.predicted, 1e-300), 10.0)
    if np.isfinite(cost) and cost < problem.cost and gain > 1e-4:
        least = min(config.relative_tolerance * problem.cost, config.absolute_tolerance)
        step.done = problem.cost - cost < least
        problem.values, problem.cost, step.linear, step.trial = step.trial, cost, None, None
        step.damping = max(step.damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-9)
        problem.damping = step.damping
        step.growth = 2.0
        if problem.watch is not None:
            problem.watch(problem)
        return
    step.damping *= step.growth
    step.growth *= 2.0
    step.done = step.damping > 1e6 or step.predicted < 1e-9 * (1.0 + problem.cost)


def _damped(linear: gtsam.GaussianFactorGraph, damping: float) -> gtsam.GaussianFactorGraph:
    """The linear graph with Marquardt's scaled damping on every unknown."""
    damped = gtsam.GaussianFactorGraph()
    for i in range(linear.size()):
        damped.push_back(linear.at(i))
    for key, diagonal in hessian_diagonal(linear).items():
        weight = np.sqrt(damping * np.clip(diagonal, 1e-6, 1e12))
        unit = gtsam.noiseModel.Unit.Create(len(weight))
        damped.push_back(gtsam.JacobianFactor(key, np.diag(weight), np.zeros(len(weight)), unit))
    return damped


def _guarded(problem: Problem, action: Callable[[Problem], None]) -> bool:
    """Run `action`; a failure is written down, so that one object's never takes the others along."""
    try:
        action(problem)
    except FAILURES as error:
        # an error may come without a word
        problem.failure = str(error).strip().split("\n")[0] or type(error).__name__
        return False
    return True
