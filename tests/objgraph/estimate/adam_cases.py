"""A toy chair to estimate by gradients, and where such an estimate starts."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from factors.state import RIGID_DOF, ObjectState
from objgraph.bench.comparison.contenders.methods import METHODS
from objgraph.estimate import AdamConfig, AdamEstimator, GaussNewtonConfig, GaussNewtonEstimator
from objgraph.estimate.adam import _Descent
from objgraph.estimate.pool import Pool
from objgraph.estimate.task import Estimate, EstimationTask, Estimator
from objgraph.estimate.terms import DrawnRays, RaySteps, draw_rays
from objgraph.graph.solve import LevenbergMarquardtConfig, SolverConfig
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from tests.toys import TOY_CODE, ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
OFF = np.array([0.05, -0.08, 0.03, 0.02, -0.03, 0.02, 0.05, -0.05, 0.03, -0.317, 0.31, -0.23, 0.14])
"""A start: degrees, centimetres and some code away from the truth."""
DIM = RIGID_DOF + TOY_CODE
SMALL = AdamConfig(iterations=12, points=60, rays=40, steps=RaySteps(samples=30))
DECODER = ToyDecoder().double()
_VIEWS: dict[float, tuple[ObjectView, ...]] = {}


def views(heading: float = 0.4) -> tuple[ObjectView, ...]:
    """Two views of a toy chair."""
    if heading not in _VIEWS:
        state, sampling = toy_state(heading), SamplingConfig(points=150, hits=100, free=100)
        _VIEWS[heading] = tuple(
            observe(toy_frame([state], azimuth, seed=i), 1, sampling) for i, azimuth in enumerate((0.3, 2.0))
        )
    return _VIEWS[heading]


def task(heading: float = 0.4, decoder: ToyDecoder | None = None, **changes) -> EstimationTask:
    prior = replace(toy_prior(), decoder=decoder or DECODER, code_mean=np.array([0.1, -0.1, 0.05, 0.0]))
    given = {
        "name": f"chair at {heading}",
        "prior": prior,
        "starts": (toy_state(heading).retract(OFF),),
        "views": views(heading),
        "up_world": UP,
    }
    return EstimationTask(**(given | changes))


def pose_error(found: ObjectState, heading: float = 0.4) -> float:
    """Metres of translation, and the metres by which half a metre turns away."""
    between = found.T_world_object.localCoordinates(toy_state(heading).T_world_object)
    return float(np.linalg.norm(between[3:]) + 0.5 * np.linalg.norm(between[:3]))


VARIANCE = np.array([1e-4] * 3 + [2e-4] * 3 + [5e-5] * 3 + [1e-3] * TOY_CODE)


def descent(config: AdamConfig, renderer, *tasks: EstimationTask) -> _Descent:
    """One whose variances differ from axis to axis."""
    found = _Descent(tasks, config, renderer)
    with torch.no_grad():
        found.log_variance.copy_(torch.as_tensor(VARIANCE).log().repeat(len(tasks), 1))
    return found


def drawn_at_start(found: _Descent) -> tuple[list[Pool], list[DrawnRays]]:
    pools = [
        pool.draw(rng, found.config.points, found.config.rays)
        for pool, rng in zip(found.pools, found.rngs, strict=True)
    ]
    return pools, draw_rays(found.decoder, found.states, pools, found.config.steps)


def loss_and_gradients(found: _Descent, pools, rays) -> tuple[float, np.ndarray, np.ndarray]:
    """Of the first object."""
    loss = float(found._gradients(pools, rays, 0)[0])
    assert found.delta.grad is not None
    assert not found.failures
    variance = torch.zeros_like(found.delta) if found.log_variance.grad is None else found.log_variance.grad
    return loss, found.delta.grad[0].numpy().copy(), variance[0].numpy().copy()


def result(of: EstimationTask, estimator) -> Estimate:
    (found,) = estimator.estimate([of])
    assert isinstance(found, Estimate)
    return found


def quick(name: str) -> Estimator:
    """A method with few points, rays and iterations."""
    estimator: Any = METHODS[name].estimator()
    if isinstance(estimator, AdamEstimator):
        steps = replace(estimator.config.steps, samples=30)
        config = replace(estimator.config, iterations=25, points=100, rays=80, steps=steps)
        return replace(estimator, config=config)
    if isinstance(estimator, GaussNewtonEstimator):
        return replace(estimator, config=replace(estimator.config, iterations=6, points=100, rays=80))
    inner = LevenbergMarquardtConfig(iterations=3)
    return replace(estimator, solver=SolverConfig(slopes=(60.0, 200.0), rounds=3, inner=inner))


GAUSS_NEWTON = GaussNewtonEstimator(GaussNewtonConfig(iterations=4, points=60, rays=40))
