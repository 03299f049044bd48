"""One object by its views alone, at cameras as the map has them: as it is first seen, as it enters, and now and then again."""

from collections.abc import Sequence

import gtsam
import numpy as np

from factors.state import ObjectState
from objgraph.errors import ObjectGraphError, SolveError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import FirstStates, first_states
from objgraph.graph.solve import SolverConfig
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.incremental.config import IncrementalConfig

_SAME = np.radians(45)
"""Turns by less are the same heading."""


def rough_estimate(
    name: str, prior: ShapePrior, view: ObjectView, builder: ObjectBuilder, config: IncrementalConfig
) -> Estimate:
    """Place an object by its first view and solve it roughly, to be recognised by; raises ObjectGraphError."""
    first = first_states(prior, [view], builder, config.initialisation)
    likeliest = FirstStates(first.states[:1], first.chances[:1])
    return _estimated(name, prior, [view], builder, config, likeliest, config.rough, None)


def first_estimate(
    name: str,
    prior: ShapePrior,
    views: Sequence[ObjectView],
    builder: ObjectBuilder,
    config: IncrementalConfig,
) -> Estimate:
    """Place an object that is to enter by its views, and solve the headings that it may have; raises ObjectGraphError."""
    first = first_states(prior, views, builder, config.initialisation)
    return _estimated(name, prior, views, builder, config, first, config.start, HeadingModesConfig())


def next_estimate(
    name: str,
    prior: ShapePrior,
    views: Sequence[ObjectView],
    builder: ObjectBuilder,
    config: IncrementalConfig,
    state: ObjectState,
    *,
    may_turn: bool,
) -> Estimate:
    """Solve an object of the map again, beginning where it is and, if it `may_turn`, at the other headings that its views
    now leave; raises ObjectGraphError."""
    if not may_turn:
        return _estimated(name, prior, views, builder, config, FirstStates((state,)), config.tracking, None)
    starts = FirstStates((state,))
    if prior.guess is not None:
        first = first_states(prior, views, builder, config.initialisation)
        said = [
            (other, p, is_turned(state, other)) for other, p in zip(first.states, first.chances, strict=True)
        ]
        own = max([config.initialisation.least_chance, *(p for _, p, turned in said if not turned)])
        others = [(other, p) for other, p, turned in said if turned]
        starts = FirstStates((state, *(other for other, _ in others)), (own, *(p for _, p in others)))
    return _estimated(name, prior, views, builder, config, starts, config.tracking, HeadingModesConfig())


def is_turned(a: ObjectState, b: ObjectState) -> bool:
    """Whether two states of an object have different headings, and no linear step leads from one to the other."""
    between = a.T_world_object.rotation().between(b.T_world_object.rotation())
    return bool(np.linalg.norm(gtsam.Rot3.Logmap(between)) > _SAME)


def _estimated(
    name: str,
    prior: ShapePrior,
    views: Sequence[ObjectView],
    builder: ObjectBuilder,
    config: IncrementalConfig,
    starts: FirstStates,
    solver: SolverConfig,
    headings: HeadingModesConfig | None,
) -> Estimate:
    assert builder.up_world is not None  # or nothing would have been placed
    task = EstimationTask(
        name, prior, starts.states, tuple(views), builder.up_world, builder.floor, chances=starts.chances
    )
    (result,) = GraphEstimator(config.graph, solver, heading_modes=headings).estimate([task])
    if isinstance(result, ObjectGraphError):
        raise result
    if result.covariance is None:
        raise SolveError(f"{name}: its estimate has no covariance")
    return result
