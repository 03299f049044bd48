"""One object by its views alone, at cameras as the map has them: as it is first seen, as it enters, and now and then again."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.trust import Trust, judge_estimate, shipped_calibration

_SAME = np.radians(45)
"""Turns by less are the same heading."""


@dataclass(frozen=True)
class Alone:
    """An object and what has been seen of it; every estimate raises ObjectGraphError where there is none."""

    name: str
    prior: ShapePrior
    views: Sequence[ObjectView]
    builder: ObjectBuilder
    config: IncrementalConfig

    def rough(self) -> Estimate:
        """Where it is about, to be recognised by."""
        first = self._first
        return self._solved(FirstStates(first.states[:1], first.chances[:1]), self.config.rough, None)

    def first(self) -> Estimate:
        """As it may enter the map: all headings that its views leave are solved."""
        return self._solved(self._first, self.config.start, HeadingModesConfig())

    def trust(self, estimate: Estimate) -> Trust | None:
        """The verdict on an estimate; None where the shipped calibration knows nothing of such objects."""
        known, prior = shipped_calibration(), self.prior
        if known.of(prior.category, prior.digest) is None:
            return None
        surface = np.asarray(extract_mesh(prior.decoder, estimate.state.code).vertices)
        judged = judge_estimate(self._task(self._first), estimate, estimate.state.to_world(surface), known)
        return None if judged is None else judged.trust

    def again(self, state: ObjectState) -> Estimate:
        """Beginning where it is, and in no other heading."""
        return self._solved(FirstStates((state,)), self.config.tracking, None)

    def again_in_all_headings(self, state: ObjectState) -> Estimate:
        """Beginning where it is and at the other headings that its views leave; less than a nat does not turn it."""
        starts = FirstStates((state,)) if self.prior.guess is None else self._beside(state)
        found = self._solved(starts, self.config.tracking, HeadingModesConfig())
        modes = found.turns
        if modes is None or not is_turned(found.state, state):
            return found
        before = [i for i, other in enumerate(modes.states) if other and not is_turned(other, state)]
        if not before or modes.probability[0] > np.e * modes.probability[before[0]]:
            return found
        return replace(self.again(state), turns=modes.turned(before[0]))

    @cached_property
    def _first(self) -> FirstStates:
        return first_states(self.prior, self.views, self.builder, self.config.initialisation)

    def _beside(self, state: ObjectState) -> FirstStates:
        """The state, as likely as the first guess holds its heading, and the other headings' states."""
        first = self._first
        said = list(zip(first.states, first.chances, strict=True))
        others = [(other, p) for other, p in said if is_turned(state, other)]
        same = [p for other, p in said if not is_turned(state, other)]
        own = max([self.config.initialisation.least_chance, *same])
        return FirstStates((state, *(other for other, _ in others)), (own, *(p for _, p in others)))

    def _solved(
        self, starts: FirstStates, solver: SolverConfig, headings: HeadingModesConfig | None
    ) -> Estimate:
        estimator = GraphEstimator(self.config.graph, solver, heading_modes=headings)
        (result,) = estimator.estimate([self._task(starts)])
        if isinstance(result, ObjectGraphError):
            raise result
        if result.covariance is None:
            raise SolveError(f"{self.name}: its estimate has no covariance")
        return result

    def _task(self, starts: FirstStates) -> EstimationTask:
        up_world, floor = self.builder.up_world, self.builder.floor
        assert up_world is not None  # or nothing would have been placed
        return EstimationTask(
            self.name, self.prior, starts.states, tuple(self.views), up_world, floor, chances=starts.chances
        )


def is_turned(a: ObjectState, b: ObjectState) -> bool:
    """Whether two states of an object have different headings, and no linear step leads from one to the other."""
    between = a.T_world_object.rotation().between(b.T_world_object.rotation())
    return bool(np.linalg.norm(gtsam.Rot3.Logmap(between)) > _SAME)
