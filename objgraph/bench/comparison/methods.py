"""The methods that can be compared, by name: each is an estimator and how densely it samples the views.

`ours` and its variants, `dsp-slam` and `node-slam` are the rows of the paper's tables (there called Ours,
Ours w/ Det2D, Ours w/ Samp2D, DSP-SLAM* and Node-SLAM*).
"""

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from factors.gaussian_depth import Deterministic, Sampled
from objgraph.errors import EvaluationError, ObjectGraphError, SolveError
from objgraph.estimate import AdamConfig, AdamEstimator, GaussNewtonEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate, EstimationTask, Estimator, unusable
from objgraph.graph.builder import GraphConfig
from objgraph.observation.sampling import SamplingConfig

log = logging.getLogger(__name__)

_DENSE = SamplingConfig(points=1000, hits=500, free=500)
"""As many of one view as an iteration of the paper's estimator takes; of several views it draws among them."""


StartKind = Literal["best", "icp", "icp-7dof"]
"""The best of our initialisation; the prior's mean shape by ICP, at its category's mean size, or of one scale from the points."""


@dataclass(frozen=True)
class StandStill:
    """Estimates the start itself."""

    def estimate(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None = None
    ) -> list[Estimate | SolveError]:
        """See `Estimator`."""
        return [unusable(task) or Estimate(task.starts[0], None, math.nan, math.nan, 0, 0) for task in tasks]


@dataclass(frozen=True)
class Method:
    """How one method estimates an object."""

    estimator: Callable[[], Estimator]
    sampling: SamplingConfig
    """Of every view; which frames are viewed is the same for all methods."""
    start: StartKind = "icp"
    """Where it begins by itself."""
    given: tuple[str, ...] = ()
    """What it is told beside views, prior and start."""


_GRAVITY = ("upright", "floor")

METHODS: dict[str, Method] = {
    "start": Method(StandStill, SamplingConfig()),
    "start-7dof": Method(StandStill, SamplingConfig(), "icp-7dof"),
    "graph": Method(GraphEstimator, SamplingConfig(), "best", (*_GRAVITY, "filled box", "heading modes")),
    "graph-bare": Method(
        lambda: GraphEstimator(GraphConfig(sides=None), heading_modes=None, gravity=False), SamplingConfig()
    ),
    "graph-prob2d": Method(
        lambda: GraphEstimator(GraphConfig(renderer="probabilistic")), SamplingConfig(), "best"
    ),
    "graph-samp2d": Method(lambda: GraphEstimator(GraphConfig(renderer="sampled")), SamplingConfig(), "best"),
    "graph-det2d": Method(
        lambda: GraphEstimator(GraphConfig(renderer="deterministic")), SamplingConfig(), "best"
    ),
    "ours": Method(AdamEstimator, _DENSE),
    "ours-floor": Method(lambda: AdamEstimator(AdamConfig(standing=True)), _DENSE, given=_GRAVITY),
    "ours-det2d": Method(lambda: AdamEstimator(renderer=Deterministic()), _DENSE),
    "ours-samp2d": Method(lambda: AdamEstimator(renderer=Sampled()), _DENSE),
    "dsp-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False), renderer=Deterministic()), _DENSE
    ),
    "dsp-slam-gn": Method(GaussNewtonEstimator, _DENSE, "icp-7dof"),
    "node-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False, surface_weight=0.0), renderer=Sampled()), _DENSE
    ),
}


def method(name: str) -> Method:
    """The method called `name`; raises EvaluationError that lists all."""
    if name not in METHODS:
        raise EvaluationError(f"no method '{name}'; available: {', '.join(METHODS)}")
    return METHODS[name]


class Clock:
    """What passes from now on, of time and of this process's processor time."""

    def __init__(self) -> None:
        self._begun, self._begun_cpu = time.perf_counter(), time.process_time()

    def spent(self, objects: int = 1) -> dict[str, float]:
        """Each object's even share."""
        seconds, cpu = time.perf_counter() - self._begun, time.process_time() - self._begun_cpu
        return {"seconds": seconds / max(objects, 1), "seconds_cpu": cpu / max(objects, 1)}


def estimated(estimator: Estimator, tasks: Sequence[EstimationTask]) -> list[Estimate | SolveError]:
    """What comes of the tasks; what an estimator raises is the failure of all."""
    try:
        return estimator.estimate(tasks)
    except Exception as error:  # a method may not stop the others
        log.debug("%s", estimator, exc_info=True)
        return [SolveError(failure_of(error))] * len(tasks)


def failure_of(error: Exception) -> str:
    """In words; a bug with its class."""
    return str(error) if isinstance(error, ObjectGraphError) else f"{type(error).__name__}: {error}"
