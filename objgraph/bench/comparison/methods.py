"""The methods that can be compared, by name: each is an estimator and how densely it samples the views.

`ours` and its variants, `dsp-slam` and `node-slam` are the rows of the paper's tables (there called Ours,
Ours w/ Det2D, Ours w/ Samp2D, DSP-SLAM* and Node-SLAM*).
"""

from collections.abc import Callable
from dataclasses import dataclass

from factors.gaussian_depth import Deterministic, Sampled
from objgraph.errors import EvaluationError
from objgraph.estimate import AdamConfig, AdamEstimator, GaussNewtonEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimator
from objgraph.graph.builder import GraphConfig
from objgraph.observation.sampling import SamplingConfig

_DENSE = SamplingConfig(points=1000, hits=500, free=500)
"""As many of one view as an iteration of the paper's estimator takes; of several views it draws among them."""


@dataclass(frozen=True)
class Method:
    """How one method estimates an object."""

    estimator: Callable[[], Estimator]
    sampling: SamplingConfig
    """Of every view; which frames are viewed is the same for all methods."""


METHODS: dict[str, Method] = {
    "graph": Method(GraphEstimator, SamplingConfig()),
    "graph-prob2d": Method(lambda: GraphEstimator(GraphConfig(renderer="probabilistic")), SamplingConfig()),
    "graph-samp2d": Method(lambda: GraphEstimator(GraphConfig(renderer="sampled")), SamplingConfig()),
    "graph-det2d": Method(lambda: GraphEstimator(GraphConfig(renderer="deterministic")), SamplingConfig()),
    "ours": Method(AdamEstimator, _DENSE),
    "ours-det2d": Method(lambda: AdamEstimator(renderer=Deterministic()), _DENSE),
    "ours-samp2d": Method(lambda: AdamEstimator(renderer=Sampled()), _DENSE),
    "dsp-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False), renderer=Deterministic()), _DENSE
    ),
    "dsp-slam-gn": Method(GaussNewtonEstimator, _DENSE),
    "node-slam": Method(
        lambda: AdamEstimator(AdamConfig(uncertainty=False, surface_weight=0.0), renderer=Sampled()), _DENSE
    ),
}


def method(name: str) -> Method:
    """The method called `name`; raises EvaluationError that lists all."""
    if name not in METHODS:
        raise EvaluationError(f"no method '{name}'; available: {', '.join(METHODS)}")
    return METHODS[name]
