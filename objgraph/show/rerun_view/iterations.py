"""How the solver comes to an object: its steps on the timeline `iteration`."""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import rerun as rr

from factors.state import ObjectState
from objgraph.errors import SolveError
from objgraph.graph.single_object import ALONE, SingleObject
from objgraph.graph.solve import Problem
from objgraph.priors.shape_prior import ShapePrior
from objgraph.show.rerun_view import paths
from objgraph.show.rerun_view.shapes import Rgb
from objgraph.show.rerun_view.states import log_state

_RESOLUTION = 32
"""Cells along an edge of the canonical cube: there are many meshes."""
_COLOR: Rgb = (230, 159, 0)


class Step(NamedTuple):
    """An object after an accepted step, or where it began."""

    state: ObjectState
    cost: float | None
    """With what was frozen in that round; None of the start."""


class Iterates:
    """Remembers the steps of every problem that it watches: give it to `map_scan` as `watch`."""

    def __init__(self) -> None:
        self._steps: dict[int, list[Step]] = {}
        self._problems: list[Problem] = []  # kept, so that none gets the id of another

    def __call__(self, problem: Problem) -> None:
        assert isinstance(problem, SingleObject)
        if id(problem) not in self._steps:
            self._problems.append(problem)
            self._steps[id(problem)] = [Step(ObjectState.from_values(problem.start, ALONE), None)]
        self._steps[id(problem)].append(Step(problem.state, problem.cost))

    def towards(self, state: ObjectState) -> list[Step]:
        """The steps of the problem that came nearest to a state: of several starts the one that was taken."""

        def distance(steps: list[Step]) -> float:
            return min(float(np.linalg.norm(state.local_coordinates(step.state))) for step in steps)

        return min(self._steps.values(), key=distance, default=[])


def log_iterations(recording: rr.RecordingStream, prior: ShapePrior, steps: Sequence[Step]) -> None:
    """Mesh and box after each step that has a surface, and its cost, which is that of another problem in every round."""
    for i, step in enumerate(steps):
        recording.set_time(paths.ITERATION, sequence=i)
        with suppress(SolveError):
            log_state(recording, paths.ITERATE, prior, step.state, f"step {i}", _COLOR, _RESOLUTION)
        if step.cost is not None:
            recording.log(paths.COST, rr.Scalars(step.cost))
    recording.reset_time()
