"""Which of the headings that its views leave an object has."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from factors.state import ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.graph.builder import DetectedBox, ObjectBuilder
from objgraph.graph.initialise import InitialisationConfig, first_states
from objgraph.graph.single_object import SingleObject
from objgraph.graph.solve import SolverConfig, solve
from objgraph.observation.sampling import ObjectView, thinned
from objgraph.priors.shape_prior import ShapePrior

SAMPLES = 600
"""Surface points, and rays, of all views together that an object is estimated by."""


def place(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    builder: ObjectBuilder,
    initialisation: InitialisationConfig | None = None,
    box: DetectedBox | None = None,
) -> tuple[ObjectState, HeadingModes | None]:
    """An object about where its views at known cameras, and a detector's box, say that it is, in its likeliest heading, and how
    likely others are; None where the prior has no first guess.

    Raises as `first_states` does.
    """
    first = first_states(prior, views, builder, initialisation, box)
    some = thinned(views, SAMPLES, SAMPLES)
    tried = [builder.alone(prior, state, some, box) for state in first.states]
    solve(tried, coarsely(SolverConfig()))
    nat = 1.0 if prior.guess is None else prior.guess.config.temperature
    best, modes = likeliest(tried, first.chances, nat)
    return (first.states[0] if tried[best].failure else tried[best].state), modes


def coarsely(solver: SolverConfig) -> SolverConfig:
    """What tells headings apart: the first slope alone, once."""
    return replace(solver, slopes=solver.slopes[:1], rounds=1)


def likeliest(
    tried: Sequence[SingleObject], chances: Sequence[float], temperature: float
) -> tuple[int, HeadingModes | None]:
    """The likeliest of some headings that were solved, by what they cost, `temperature` a nat, and by the first guess's `chances`,
    and how likely the others are beside it. None where there are no chances, costs alone then choose; or where all failed."""
    unlikely = -temperature * np.log(chances or np.ones(len(tried)))
    costs = np.array([np.inf if each.failure else each.cost for each in tried]) + unlikely
    best = int(np.argmin(costs))
    if not chances or not np.isfinite(costs[best]):
        return best, None
    return best, HeadingModes.of_states([each.state for each in tried], costs, best, temperature)
