"""What enters the map is solved before it does: the smoother's own steps are not damped."""

from collections.abc import Sequence

import gtsam

from factors.batch import prefetch
from factors.surface import SurfaceFactor
from objgraph.covariance.quantile import squared_limit
from objgraph.errors import SolveError
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, minimize, solve
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.tracked import Observation, TrackedObject

_CLOSELY = LevenbergMarquardtConfig(iterations=20, relative_tolerance=1e-5)
"""Where an object enters: what is then left to go is for the smoother's first step."""
_EXACTLY = LevenbergMarquardtConfig(iterations=8, relative_tolerance=1e-5)
_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Of a full step that are tried, the longest first."""
_STEPS = 12
_LITTLE = 1e-3
"""Cost (half a chi-squared) that a step must gain for another one to be worth it."""
_MISFIT = 1.5
"""Score of a seen point above which the surface passes it by: of residuals twice as large as their noise."""
_PLAUSIBLE = 1 - 1e-6
"""Share of all objects, if the priors are right, that are less unlike their mean."""


def solved(
    name: str,
    known: Sequence[gtsam.NonlinearFactor],
    observations: Sequence[Observation],
    start: gtsam.Values,
    config: IncrementalConfig,
) -> Problem:
    """The variables of `start`, of which `known` says what the observations do not; raises SolveError."""
    problem = _problem(name, known, observations, start)
    solve([problem], config.tracking)
    if problem.failure is not None:
        raise SolveError(f"{name}: {problem.failure}")
    return problem


def at_optimum(
    name: str,
    known: Sequence[gtsam.NonlinearFactor],
    observations: Sequence[Observation],
    start: gtsam.Values,
) -> gtsam.Values:
    """As `solved`, with everything frozen as it is and until nothing is left to gain."""
    problem = _problem(name, known, observations, start)
    minimize(problem, _EXACTLY)
    polish(problem)
    return problem.values


def polish(problem: Problem) -> None:
    """Go on along undamped steps, as far along each as pays; raises SolveError where there is none.

    Damping holds back what all objects and cameras do together, of which every factor says little; kinks of the
    decoder hold back full steps.
    """
    for _ in range(_STEPS):
        prefetch(problem.factors, problem.values, jacobian=True)
        step, cost = _full_step(problem), problem.cost
        for share in _SHARES:
            trial = problem.values.retract(step.scale(share))
            if (at_trial := problem.cost_at(trial)) < problem.cost:
                problem.values, problem.cost = trial, at_trial
                break
        if not problem.cost < cost - _LITTLE:
            return


def _full_step(problem: Problem) -> gtsam.VectorValues:
    try:
        return problem.graph.linearize(problem.values).optimize()
    except RuntimeError as error:  # GTSAM's "indeterminate linear system"
        raise SolveError(f"{problem.name}: nothing determines it: {error}") from error


def _problem(
    name: str,
    known: Sequence[gtsam.NonlinearFactor],
    observations: Sequence[Observation],
    start: gtsam.Values,
) -> Problem:
    graph = gtsam.NonlinearFactorGraph()
    for factor in known:
        graph.push_back(factor)
    own = [factor for observation in observations for factor in observation.factors]
    for factor in own:
        graph.push_back(factor.gtsam_factor())
    return Problem(name, graph, start, own)


def settled(
    problem: Problem,
    priors: Sequence[gtsam.NonlinearFactor],
    observations: Sequence[Observation],
    entry: TrackedObject,
) -> gtsam.Values:
    """A solved problem's optimum with everything frozen as it is, if it is one to begin from.

    Raises:
        SolveError: the smoother's first step, which is undamped, leads far uphill, or to what is unlike all that the
            `priors` of `entry` know, or elsewhere than the views: the start was too far off.
    """
    minimize(problem, _CLOSELY)
    first = problem.values.retract(_full_step(problem))
    rise = problem.cost_at(first) - problem.cost
    if not rise < problem.values.dim() / 2:  # as a draw from the posterior, if it is Gaussian, on average is
        raise SolveError(_too_far(problem, f"a full step from there costs {rise:.1f} more"))
    squared, dimension = _unlikeness(priors, first, entry)
    limit = squared_limit(_PLAUSIBLE, dimension)
    if squared > limit:
        raise SolveError(
            _too_far(
                problem, f"its priors' chi-squared is {squared:.0f} after a full step, above {limit:.0f}"
            )
        )
    misfit = _misfit(observations, first)
    if misfit > _MISFIT:
        raise SolveError(
            _too_far(
                problem,
                f"its seen points score {misfit:.1f} each after a full step, above {_MISFIT}: its surface passes them by",
            )
        )
    return problem.values


def _unlikeness(
    priors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, entry: TrackedObject
) -> tuple[float, int]:
    """The object's squared Mahalanobis length under its priors, and over how many dimensions."""
    squared, dimension = 2 * sum(factor.error(values) for factor in priors), sum(f.dim() for f in priors)
    kinds = entry.prior.kinds
    if kinds is not None:  # a rare kind is not unlike itself: the length is that from the nearest kind
        costs = kinds.costs(values.atVector(entry.keys.code)[None])[0]
        squared += 2 * ((costs - kinds.rarity).min() - costs.min())
        dimension -= 1
    return squared, dimension


def _too_far(problem: Problem, why: str) -> str:
    return (
        f"{problem.name}: the best place that was found for it is none ({why}): "
        "start it nearer to its place, or with more views"
    )


def _misfit(observations: Sequence[Observation], values: gtsam.Values) -> float:
    """Mean score of an independent measurement of the surface; about 0.7 where the noise is as believed."""
    factors = [f for observation in observations for f in observation.factors if isinstance(f, SurfaceFactor)]
    return sum(f.loss(values) for f in factors) / max(sum(f.measurements for f in factors), 1.0)
