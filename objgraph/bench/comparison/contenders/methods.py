"""The methods that can be compared, by name: each is an estimator and how densely it samples the views.

`ours` and its variants, `dsp-slam` and `node-slam` are the rows of the paper's tables (there called Ours,
Ours w/ Det2D, Ours w/ Samp2D, DSP-SLAM* and Node-SLAM*). Those that end in `-released` do as the released programs do.
"""

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from factors.gaussian_depth import Deterministic, Sampled
from objgraph.bench.comparison.contenders.released import (
    RELEASED_DET2D,
    RELEASED_GN,
    RELEASED_OURS,
    STEADY_GN,
    changed,
)
from objgraph.errors import EvaluationError, ObjectGraphError, SolveError
from objgraph.estimate import AdamConfig, AdamEstimator, GaussNewtonConfig, GaussNewtonEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate, EstimationTask, Estimator, unusable
from objgraph.graph.builder import GraphConfig
from objgraph.graph.solve import SolverConfig
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


def _graph(renderer: Literal["full", "probabilistic", "sampled", "deterministic"]) -> Method:
    told = (*_GRAVITY, "filled box", "heading modes")
    return Method(lambda: GraphEstimator(GraphConfig(renderer=renderer)), SamplingConfig(), "best", told)


def _det2d() -> AdamEstimator:
    return AdamEstimator(renderer=Deterministic())


def _steady(config: GaussNewtonConfig | None = None) -> Estimator:
    """DSP-SLAM's Gauss-Newton as it does not overflow."""
    return changed(GaussNewtonEstimator(config or GaussNewtonConfig()), STEADY_GN.values())


_GRAVITY = ("floor", "upright")
GN_SHORT = "dsp-slam-gn-short"
"""`dsp-slam-gn` with half the iterations, on as many samples as the graph takes: what its time is measured against."""

METHODS: dict[str, Method] = {
    "start": Method(StandStill, SamplingConfig()),
    "start-7dof": Method(StandStill, SamplingConfig(), "icp-7dof"),
    "graph": _graph("full"),
    "graph-bare": Method(
        lambda: GraphEstimator(GraphConfig(sides=None), heading_modes=None, gravity=False), SamplingConfig()
    ),
    "graph-prob2d": _graph("probabilistic"),
    "graph-samp2d": _graph("sampled"),
    "graph-det2d": _graph("deterministic"),
    "ours": Method(AdamEstimator, _DENSE),
    "ours-floor": Method(lambda: AdamEstimator(AdamConfig(standing=True)), _DENSE, given=_GRAVITY),
    "ours-released": Method(lambda: changed(AdamEstimator(), RELEASED_OURS.values()), _DENSE),
    "ours-det2d": Method(_det2d, _DENSE),
    "ours-det2d-released": Method(
        lambda: changed(_det2d(), (RELEASED_OURS | RELEASED_DET2D).values()), _DENSE
    ),
    "ours-samp2d": Method(lambda: AdamEstimator(renderer=Sampled()), _DENSE),
    "dsp-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False), renderer=Deterministic()), _DENSE
    ),
    "dsp-slam-gn": Method(_steady, _DENSE, "icp-7dof"),
    "dsp-slam-gn-undamped": Method(GaussNewtonEstimator, _DENSE, "icp-7dof"),
    "dsp-slam-gn-released": Method(lambda: changed(_steady(), RELEASED_GN.values()), _DENSE, "icp-7dof"),
    GN_SHORT: Method(
        lambda: _steady(
            GaussNewtonConfig(iterations=10, points=GraphEstimator.samples, rays=GraphEstimator.samples)
        ),
        SamplingConfig(),
        "icp-7dof",
    ),
    "node-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False, surface_weight=0.0), renderer=Sampled()), _DENSE
    ),
}


RELEASED_DIFFERENCES: dict[str, Method] = {
    f"{base}+{name}": Method(lambda start=start, change=change: change(start()), _DENSE, METHODS[base].start)
    for base, start, changes in (
        ("ours", AdamEstimator, RELEASED_OURS),
        ("ours-det2d", _det2d, RELEASED_DET2D),
        ("dsp-slam-gn", _steady, RELEASED_GN),
        ("dsp-slam-gn-undamped", GaussNewtonEstimator, STEADY_GN),
    )
    for name, change in changes.items()
}
"""`ours`, `ours-det2d`, `dsp-slam-gn` and `dsp-slam-gn-undamped`, each with one difference of the released program: `ours+clipping`."""

GRAPH_ENDED: dict[str, Method] = {
    "graph-guess": Method(StandStill, SamplingConfig(), "best"),
    **{
        f"graph-{rounds}-rounds": Method(
            lambda rounds=rounds: GraphEstimator(solver=SolverConfig(rounds=rounds)), SamplingConfig(), "best"
        )
        for rounds in range(SolverConfig.rounds)
    },
}
"""Where the graph begins, and the graph ended after so many rounds with all points: how good it is how soon."""


def method(name: str) -> Method:
    """The method called `name`, or one of `RELEASED_DIFFERENCES` or `GRAPH_ENDED`; raises EvaluationError that lists all but
    these."""
    found = METHODS.get(name) or RELEASED_DIFFERENCES.get(name) or GRAPH_ENDED.get(name)
    if found is None:
        raise EvaluationError(f"no method '{name}'; available: {', '.join(METHODS)}")
    return found


def released(name: str) -> str:
    """The name of a method, with its start if it has one, as the released program is, where there is one."""
    own, at, start = name.partition("@")
    return f"{own}-released{at}{start}" if f"{own}-released" in METHODS else name


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
