"""The headings beside an estimate's: the same box turned by quarters, solved anew on few points, all objects together."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.depth import RaySampling
from factors.state import ObjectState
from objgraph.covariance.heading_modes import QUARTERS, HeadingModes
from objgraph.errors import ConfigError, ObjectGraphError
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.initialise import free_points, misfit
from objgraph.graph.single_object import SingleObject
from objgraph.graph.solve import LevenbergMarquardtConfig, SolverConfig, solve
from objgraph.observation.sampling import thinned
from objgraph.priors.shape_prior import ShapePrior


@dataclass(frozen=True)
class HeadingModesConfig:
    """Which headings are tried, how cheaply they are told apart, and how much is believed of it."""

    reach: float = 6.0
    """A turned shape whose mean distance from points and into free space is more than this times the estimate's is not
    solved: it has no chance."""
    points: int = 150
    """Surface points of all views together."""
    rays: int = 150
    """Rays of all views together."""
    sampling: RaySampling = field(default_factory=lambda: RaySampling(coarse=12, cells=8))
    solver: SolverConfig = field(
        default_factory=lambda: SolverConfig(
            (60.0,), 3, inner=LevenbergMarquardtConfig(iterations=4, relative_tolerance=1e-2)
        )
    )
    temperature: float = 5.0
    """Cost that counts as one nat. Costs are weighted energy scores, no log-likelihoods, and what the prior cannot make tells
    headings apart by chance, as noise does not: the likeliest on development objects (docs/decisions/2026-11-covariances.md). A turn that
    costs less by less than this is not taken. Headings that a first guess proposes have the guess's own (`FirstGuessConfig.temperature`)."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, points=checks.Range(1), rays=checks.Range(1), temperature=checks.POSITIVE
        )


@dataclass(frozen=True)
class Turned:
    """The best that was found at each quarter turn of one estimate, from the same few points."""

    costs: Float[np.ndarray, "4"]
    """The estimate's own heading first; infinite where nothing was solved."""
    states: tuple[ObjectState | None, ...]
    linearizations: int
    error_evaluations: int

    @property
    def cheapest(self) -> int:
        """The quarter."""
        return int(np.argmin(self.costs))

    def turns(self, quarter: int, temperature: float) -> HeadingModes:
        """Of the object as it stands turned by so many quarters."""
        return HeadingModes.of_costs(self.costs, temperature, self.states).turned(quarter)


def heading_modes(
    tasks: Sequence[EstimationTask],
    estimates: Sequence[ObjectState],
    graph: GraphConfig,
    config: HeadingModesConfig,
) -> list[Turned | None]:
    """What each estimate costs, and would turned; None where no turn of it comes near, its prior has no common box, or a
    detector said how it stands.

    At each heading the estimate's own code and the likeliest of the prior's starting shapes are solved.
    """
    attempts = [
        _attempts(task, estimate, graph, config) for task, estimate in zip(tasks, estimates, strict=True)
    ]
    solve([single for several in attempts for _, single in several], config.solver)
    return [_best(several) if several else None for several in attempts]


def _attempts(
    task: EstimationTask, estimate: ObjectState, graph: GraphConfig, config: HeadingModesConfig
) -> list[tuple[int, SingleObject]]:
    """Problems by quarter; none where no turned shape has a chance."""
    prior = task.prior
    if prior.box is None or task.box is not None:
        return []
    p_surface = np.concatenate([view.points_world for view in task.views])
    p_free = free_points(task.views)
    tried: list[tuple[int, ObjectState]] = []
    for quarter in range(QUARTERS):
        starts = [turned(estimate, quarter, prior, code) for code in prior.starts]
        best = int(np.argmin(misfit(prior, starts, p_surface, p_free)))
        tried += [(quarter, turned(estimate, quarter, prior)), (quarter, starts[best])]
    off = misfit(prior, [state for _, state in tried], p_surface, p_free)
    tried = [
        each for i, each in enumerate(tried) if each[0] == 0 or off[i] < config.reach * max(off[0], 1e-6)
    ]
    if all(quarter == 0 for quarter, _ in tried):
        return []
    thin = thinned(task.views, config.points, config.rays)
    cheap = ObjectBuilder(replace(graph, sampling=config.sampling), task.up_world, task.floor)
    found: list[tuple[int, SingleObject]] = []
    for quarter, state in tried:
        with suppress(ObjectGraphError):  # an estimate that ended where it could not have begun is not turned
            found.append((quarter, cheap.alone(prior, state, thin)))
    return found


def turned(
    state: ObjectState, quarter: int, prior: ShapePrior, code: Float[np.ndarray, "l"] | None = None
) -> ObjectState:
    """The object turned by so many quarters about its up axis within its metric box, of its own shape or another."""
    assert prior.box is not None
    quarters = gtsam.Pose3(gtsam.Rot3.Ry(quarter * np.pi / 2), np.zeros(3))
    edges = state.scale * prior.box
    edges = edges[[2, 1, 0]] if quarter % 2 else edges
    return ObjectState(
        state.T_world_object.compose(quarters),
        np.log(edges / prior.box),
        np.array(state.code if code is None else code, dtype=float),
    )


def _best(attempts: Sequence[tuple[int, SingleObject]]) -> Turned:
    costs = np.full(QUARTERS, np.inf)
    states: list[ObjectState | None] = [None] * QUARTERS
    for quarter, single in attempts:
        if single.failure is None and single.cost < costs[quarter]:
            costs[quarter], states[quarter] = single.cost, single.state
    problems = [single for _, single in attempts]
    return Turned(
        costs,
        tuple(states),
        sum(problem.linearizations for problem in problems),
        sum(problem.error_evaluations for problem in problems),
    )
