"""The factor graph as an estimator: Levenberg-Marquardt on the object's own graph, marginals from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from objgraph.errors import ObjectGraphError, SolveError
from objgraph.estimation import Estimate, EstimationTask, unusable
from objgraph.object_factors import GraphConfig
from objgraph.single_object import SingleObject, single_object
from objgraph.solve import SolverConfig, solve


@dataclass(frozen=True)
class GraphEstimator:
    """Every start is solved at the coarsest slope; the cheapest is solved to the end."""

    graph: GraphConfig = field(default_factory=GraphConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)

    def estimate(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None = None
    ) -> list[Estimate | SolveError]:
        """See `Estimator`; all objects decode together."""
        refused = [unusable(task) for task in tasks]
        usable = [task for task, reason in zip(tasks, refused, strict=True) if reason is None]
        found = iter(self._solved(usable, progress))
        return [next(found) if reason is None else reason for reason in refused]

    def _solved(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None
    ) -> list[Estimate | SolveError]:
        attempts = [
            [
                single_object(task.prior, start, task.views, task.up_world, task.floor, self.graph, task.box)
                for start in task.starts
            ]
            for task in tasks
        ]
        first = replace(self.solver, slopes=self.solver.slopes[:1], rounds=1)
        solve([attempt.problem for several in attempts for attempt in several], first)
        chosen = [_cheapest(several) for several in attempts]
        costs = [_begin(attempt, self.solver.slopes[-1]) for attempt in chosen]
        solve([attempt.problem for attempt in chosen if not attempt.problem.failure], self.solver, progress)
        last = self.solver.slopes[-1]
        return [_estimate(*each, last) for each in zip(chosen, costs, attempts, tasks, strict=True)]


def _begin(attempt: SingleObject, slope: float) -> float:
    """What the start costs at the slope at which the end will be judged; nan where it cannot be said."""
    if attempt.problem.failure is None:
        try:
            return attempt.cost_of_start(slope)
        except (ObjectGraphError, RuntimeError) as error:
            attempt.problem.failure = str(error)
    return float("nan")


def _cheapest(attempts: Sequence[SingleObject]) -> SingleObject:
    solved = [attempt for attempt in attempts if attempt.problem.failure is None]
    return min(solved or attempts[:1], key=lambda attempt: attempt.problem.cost)


def _estimate(
    attempt: SingleObject,
    cost_initial: float,
    tried: Sequence[SingleObject],
    task: EstimationTask,
    slope: float,
) -> Estimate | SolveError:
    problem = attempt.problem
    if problem.failure is not None:
        return SolveError(f"{task.name}: {problem.failure}")
    try:
        covariance = attempt.covariance(slope)
    except (ObjectGraphError, RuntimeError) as error:
        return SolveError(f"{task.name}: {error}")
    return Estimate(
        attempt.state,
        covariance,
        cost_initial,
        problem.cost,
        sum(each.problem.linearizations for each in tried),
        sum(each.problem.error_evaluations for each in tried),
    )
