"""The factor graph as an estimator: Levenberg-Marquardt on the object's own graph, marginals from it."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from factors.state import ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.errors import ObjectGraphError, SolveError
from objgraph.estimate.heading_modes import HeadingModesConfig, heading_modes
from objgraph.estimate.task import Estimate, EstimationTask, unusable
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.headings import SAMPLES, coarsely, likeliest
from objgraph.graph.single_object import SingleObject
from objgraph.graph.solve import Problem, SolverConfig, solve
from objgraph.observation.sampling import thinned


@dataclass(frozen=True)
class GraphEstimator:
    """Every start is solved at the coarsest slope; the likeliest is solved to the end.

    Where a prior's first guess says how likely the starts are, they are the headings that the object may have; of other
    objects turns are searched for afterwards, and one that is cheaper is solved to the end as well.
    """

    graph: GraphConfig = field(default_factory=GraphConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)
    heading_modes: HeadingModesConfig | None = field(default_factory=HeadingModesConfig)
    """None takes the heading that was found as the only one."""
    samples: int = SAMPLES
    """Surface points, and rays, of all views together that an object is estimated by."""
    gravity: bool = True
    """Whether it is told where up and the floor are; without, no object need be upright or stand."""
    watch: Callable[[Problem], None] | None = field(default=None, compare=False)
    """Called after each accepted step with the object's problem; each start is one."""

    def estimate(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None = None
    ) -> list[Estimate | SolveError]:
        """See `Estimator`; all objects decode together."""
        begun = [self._begun(task) for task in tasks]
        found = iter(self._solved([each for each in begun if isinstance(each, _Attempts)], progress))
        return [next(found) if isinstance(each, _Attempts) else each for each in begun]

    def _begun(self, task: EstimationTask) -> "_Attempts | SolveError":
        if (refused := unusable(task)) is not None:
            return refused
        told = replace(task, views=tuple(thinned(task.views, self.samples, self.samples)))
        told = told if self.gravity else replace(told, up_world=None, floor=None)
        try:
            return _Attempts(told, [self._single(told, start) for start in told.starts])
        except ObjectGraphError as error:
            return SolveError(f"{task.name}: {error}")

    def _solved(
        self, attempts: Sequence["_Attempts"], progress: Callable[[int, int], None] | None
    ) -> list[Estimate | SolveError]:
        solve([single for attempt in attempts for single in attempt.tried], coarsely(self.solver))
        last = self.solver.slopes[-1]
        for attempt in attempts:
            attempt.choose(self.heading_modes)
        solve([attempt.chosen for attempt in attempts if attempt.is_good], self.solver, progress)
        if self.heading_modes is not None:
            blind = [attempt for attempt in attempts if attempt.is_good and not attempt.task.chances]
            self._turn(blind, self.heading_modes)
        return [attempt.estimate(last) for attempt in attempts]

    def _single(self, task: EstimationTask, start: ObjectState) -> SingleObject:
        builder = ObjectBuilder(self.graph, task.up_world, task.floor)
        single = builder.alone(task.prior, start, task.views, task.box)
        single.watch = self.watch
        return single

    def _turn(self, attempts: Sequence["_Attempts"], config: HeadingModesConfig) -> None:
        """Solve to the end what costs less turned, take it where it still does by enough, and say how likely other headings are."""
        tasks, states = [attempt.task for attempt in attempts], [attempt.chosen.state for attempt in attempts]
        better: list[tuple[_Attempts, SingleObject, HeadingModes]] = []
        for attempt, found in zip(attempts, heading_modes(tasks, states, self.graph, config), strict=True):
            if found is None or not np.isfinite(found.costs[0]):
                continue
            attempt.linearizations += found.linearizations
            attempt.error_evaluations += found.error_evaluations
            attempt.turns = found.turns(0, config.temperature)
            state = found.states[found.cheapest]
            if found.cheapest != 0 and state is not None:
                turns = found.turns(found.cheapest, config.temperature)
                with suppress(ObjectGraphError):  # it has come to lean too far
                    better.append((attempt, self._single(attempt.task, state), turns))
        solve([single for _, single, _ in better], self.solver)
        for attempt, single, turns in better:
            attempt.tried.append(single)
            # few points often prefer a heading that all of them do not, and less than the temperature is chance
            enough = attempt.chosen.cost - config.temperature
            if single.failure is None and single.cost < enough:
                attempt.chosen, attempt.turns = single, turns


@dataclass
class _Attempts:
    """What was tried of one object."""

    task: EstimationTask
    tried: list[SingleObject]
    turns: HeadingModes | None = None
    linearizations: int = 0
    """Beside those of `tried`."""
    error_evaluations: int = 0
    chosen: SingleObject = field(init=False)

    @property
    def is_good(self) -> bool:
        return self.chosen.failure is None

    def choose(self, headings: HeadingModesConfig | None) -> None:
        """Go on from the likeliest, by what it costs and by the first guess, and say how likely other headings are."""
        guess = self.task.prior.guess
        temperature = (
            (headings or HeadingModesConfig()).temperature if guess is None else guess.config.temperature
        )
        best, modes = likeliest(self.tried, self.task.chances, temperature)
        self.chosen = self.tried[best]
        self.turns = None if headings is None else modes

    def estimate(self, slope: float) -> Estimate | SolveError:
        problem = self.chosen
        if problem.failure is not None:
            return SolveError(f"{self.task.name}: {problem.failure}")
        try:
            covariance = self.chosen.covariance(slope)
        except (ObjectGraphError, RuntimeError) as error:
            return SolveError(f"{self.task.name}: {error}")
        return Estimate(
            self.chosen.state,
            covariance,
            problem.cost_initial,
            problem.cost,
            self.linearizations + sum(single.linearizations for single in self.tried),
            self.error_evaluations + sum(single.error_evaluations for single in self.tried),
            self.turns,
        )
