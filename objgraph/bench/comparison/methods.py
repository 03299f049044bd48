"""The methods that can be compared, by name: each is an estimator and how densely it samples the views.

`ours` and its variants, `dsp-slam` and `node-slam` are the rows of the paper's tables (there called Ours,
Ours w/ Det2D, Ours w/ Samp2D, DSP-SLAM* and Node-SLAM*). Those that end in `-released` do as the released programs do.
"""

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from factors.gaussian_depth import Deterministic, Sampled, Uncentred
from factors.rendering import Renderer
from objgraph.errors import EvaluationError, ObjectGraphError, SolveError
from objgraph.estimate import AdamConfig, AdamEstimator, GaussNewtonEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate, EstimationTask, Estimator
from objgraph.graph.builder import GraphConfig
from objgraph.observation.sampling import SamplingConfig

log = logging.getLogger(__name__)

_DENSE = SamplingConfig(points=1000, hits=500, free=500)
"""As many of one view as an iteration of the paper's estimator takes; of several views it draws among them."""


@dataclass(frozen=True)
class Method:
    """How one method estimates an object."""

    estimator: Callable[[], Estimator]
    sampling: SamplingConfig
    """Of every view; which frames are viewed is the same for all methods."""
    given: tuple[str, ...] = ()
    """What it is told beyond views, prior and start."""


_Change = Callable[[Any], Any]
"""From an estimator to one with other settings."""


def _set(**changes: Any) -> _Change:
    return lambda estimator: replace(estimator, config=replace(estimator.config, **changes))


def _step(**changes: Any) -> _Change:
    return lambda estimator: _set(steps=replace(estimator.config.steps, **changes))(estimator)


def _render(renderer: Renderer) -> _Change:
    return lambda estimator: replace(estimator, renderer=renderer)


_RELEASED_OURS: dict[str, _Change] = {
    "code-weight": _set(code_weight=3000.0),
    "clipping": _set(clip=0.1),
    "depth-variance": _render(Uncentred()),
    "band": _step(band=0.025, canonical_band=True, band_samples=20),
    "world-scale": _set(world_scale=True),
    "first-view-depths": _step(first_view_depths=True),
}
"""Each way in which the released program differs from `ours`."""
_RELEASED_DET2D: dict[str, _Change] = {"squared": _render(Deterministic(squared_up_to=0.3))}
"""... and from `ours-det2d` in place of the depth's variance."""
_RELEASED_GN: dict[str, _Change] = {
    "damping": _set(damping=1.0),
    "huber": _set(huber=0.05),
    "iterations": _set(iterations=10),
    "7dof": _set(one_scale=True),
    "one-view": _set(one_view=True),
}
"""Each way in which the released DSP-SLAM differs from `dsp-slam-gn`. How strongly it damps and where its Huber weights
begin is not known here; the numbers are ours."""


def _released(estimator: Estimator, changes: Iterable[_Change]) -> Estimator:
    for change in changes:
        estimator = change(estimator)
    return estimator


def _det2d() -> AdamEstimator:
    return AdamEstimator(renderer=Deterministic())


_TOLD = ("floor", "upright", "filled box", "heading modes")

METHODS: dict[str, Method] = {
    "graph": Method(GraphEstimator, SamplingConfig(), _TOLD),
    "graph-bare": Method(
        lambda: GraphEstimator(GraphConfig(sides=None), heading_modes=None, gravity=False), SamplingConfig()
    ),
    "graph-prob2d": Method(
        lambda: GraphEstimator(GraphConfig(renderer="probabilistic")), SamplingConfig(), _TOLD
    ),
    "graph-samp2d": Method(lambda: GraphEstimator(GraphConfig(renderer="sampled")), SamplingConfig(), _TOLD),
    "graph-det2d": Method(
        lambda: GraphEstimator(GraphConfig(renderer="deterministic")), SamplingConfig(), _TOLD
    ),
    "ours": Method(AdamEstimator, _DENSE),
    "ours-floor": Method(lambda: AdamEstimator(AdamConfig(standing=True)), _DENSE, ("floor", "upright")),
    "ours-released": Method(lambda: _released(AdamEstimator(), _RELEASED_OURS.values()), _DENSE),
    "ours-det2d": Method(_det2d, _DENSE),
    "ours-det2d-released": Method(
        lambda: _released(_det2d(), (_RELEASED_OURS | _RELEASED_DET2D).values()), _DENSE
    ),
    "ours-samp2d": Method(lambda: AdamEstimator(renderer=Sampled()), _DENSE),
    "dsp-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False), renderer=Deterministic()), _DENSE
    ),
    "dsp-slam-gn": Method(GaussNewtonEstimator, _DENSE),
    "dsp-slam-gn-released": Method(lambda: _released(GaussNewtonEstimator(), _RELEASED_GN.values()), _DENSE),
    "node-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False, surface_weight=0.0), renderer=Sampled()), _DENSE
    ),
}


RELEASED_DIFFERENCES: dict[str, Method] = {
    f"{base}+{name}": Method(lambda start=start, change=change: change(start()), _DENSE)
    for base, start, changes in (
        ("ours", AdamEstimator, _RELEASED_OURS),
        ("ours-det2d", _det2d, _RELEASED_DET2D),
        ("dsp-slam-gn", GaussNewtonEstimator, _RELEASED_GN),
    )
    for name, change in changes.items()
}
"""`ours`, `ours-det2d` and `dsp-slam-gn`, each with one difference of the released program: `ours+clipping`."""


def method(name: str) -> Method:
    """The method called `name`, or one of `RELEASED_DIFFERENCES`; raises EvaluationError that lists all but these."""
    found = METHODS.get(name) or RELEASED_DIFFERENCES.get(name)
    if found is None:
        raise EvaluationError(f"no method '{name}'; available: {', '.join(METHODS)}")
    return found


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
