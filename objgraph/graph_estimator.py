"""The factor graph as an estimator: Levenberg-Marquardt on the object's own graph, marginals from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from objgraph.errors import ObjectGraphError, SolveError
from objgraph.estimation import Estimate, EstimationTask, unusable
from objgraph.graph import GraphConfig, ObjectGraph
from objgraph.initialise import single_object_graph
from objgraph.solve import Problem, SolverConfig, solve


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
        attempts = [[_Attempt.of(task, i, self.graph) for i in range(len(task.starts))] for task in tasks]
        first = replace(self.solver, slopes=self.solver.slopes[:1], rounds=1)
        solve([attempt.problem for several in attempts for attempt in several], first)
        chosen = [_cheapest(several) for several in attempts]
        for attempt in chosen:
            attempt.begin(self.solver.slopes[-1])
        solve([attempt.problem for attempt in chosen if not attempt.problem.failure], self.solver, progress)
        return [
            _estimate(attempt, several, task)
            for attempt, several, task in zip(chosen, attempts, tasks, strict=True)
        ]


@dataclass
class _Attempt:
    objects: ObjectGraph
    problem: Problem
    cost_initial: float = float("nan")

    @classmethod
    def of(cls, task: EstimationTask, start: int, config: GraphConfig) -> "_Attempt":
        objects = single_object_graph(
            task.prior, task.starts[start], task.views, task.up_world, task.floor, config
        )
        return cls(objects, objects.problems()[0])

    def begin(self, slope: float) -> None:
        """Note what the start itself costs at the slope at which the end will be judged."""
        if self.problem.failure is None:
            try:
                self.cost_initial = self.objects.problems()[0].refreshed_cost(slope)
            except (ObjectGraphError, RuntimeError) as error:
                self.problem.failure = str(error)


def _cheapest(attempts: Sequence[_Attempt]) -> _Attempt:
    solved = [attempt for attempt in attempts if attempt.problem.failure is None]
    return min(solved or attempts[:1], key=lambda attempt: attempt.problem.cost)


def _estimate(attempt: _Attempt, tried: Sequence[_Attempt], task: EstimationTask) -> Estimate | SolveError:
    problem, objects = attempt.problem, attempt.objects
    if problem.failure is not None:
        return SolveError(f"{task.name}: {problem.failure}")
    objects.values.update(problem.values)
    handle = objects.objects[0]
    try:
        covariance = objects.marginals(handle)
    except SolveError as error:
        return SolveError(f"{task.name}: {error}")
    return Estimate(
        objects.state(handle),
        covariance,
        attempt.cost_initial,
        problem.cost,
        sum(each.problem.linearizations for each in tried),
        sum(each.problem.error_evaluations for each in tried),
    )
