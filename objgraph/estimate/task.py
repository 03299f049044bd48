"""What an estimator is given of an object, and what it gives back: the graph's and the paper's stand behind it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from factors.state import ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import SolveError
from objgraph.graph.builder import DetectedBox
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior


@dataclass(frozen=True)
class EstimationTask:
    """One object to be estimated from its views at known cameras."""

    name: str
    """Whom an error message should name."""
    prior: ShapePrior
    starts: tuple[ObjectState, ...]
    """First estimates, the most promising first; an estimator may use that one alone."""
    views: tuple[ObjectView, ...]
    up_world: Float[np.ndarray, "3"] | None
    """Unit vector against gravity, in the world frame; None where it is unknown."""
    floor: float | None = None
    """Height of the floor along `up_world`, where it is known."""
    box: DetectedBox | None = None
    """What a detector says of place and size; the graph takes it for a measurement."""
    chances: tuple[float, ...] = ()
    """How likely each start is by the prior's first guess; empty where it has none."""


@dataclass(frozen=True)
class Estimate:
    """One object as an estimator found it."""

    state: ObjectState
    covariance: ObjectCovariance | None
    """None for an estimator that gives none."""
    cost_initial: float
    """Where the last minimisation began, in the estimator's own objective; NaN, as at the end, where none was of it alone."""
    cost_final: float
    linearizations: int
    """Evaluations of loss and derivatives."""
    error_evaluations: int
    """Evaluations of the loss alone."""
    turns: HeadingModes | None = None
    """How likely the object stands otherwise; None where no quarter turn of it has a chance, or none was tried."""

    @classmethod
    def of_graph(
        cls, state: ObjectState, covariance: ObjectCovariance, turns: HeadingModes | None
    ) -> "Estimate":
        """An object of a graph that was solved as a whole."""
        return cls(state, covariance, np.nan, np.nan, 0, 0, turns)


def unusable(task: EstimationTask) -> SolveError | None:
    """What is wrong with a task, if anything is."""
    if not task.starts or not task.views:
        return SolveError(f"{task.name}: an estimate needs a start and a view")
    length, given = task.prior.decoder.code_length, len(task.starts[0].code)
    if given != length:
        return SolveError(f"{task.name}: the start's code has length {given}, the decoder takes {length}")
    if task.chances and (
        len(task.chances) != len(task.starts) or not all(0 < each <= 1 for each in task.chances)
    ):
        return SolveError(
            f"{task.name}: of {len(task.starts)} starts each needs a chance above 0 and up to 1, not {task.chances}"
        )
    return None


class Estimator(Protocol):
    """Estimates many objects together; one object's failure is its own result and stops no other."""

    def estimate(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None = None
    ) -> list[Estimate | SolveError]:
        """A result for every task, in their order; `progress` is called with (steps done, steps at most)."""
        ...
