"""Floor and gravity in a loss that is descended, and a graph that is told neither."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch

from factors.floor import FloorFactor
from objgraph.estimate import AdamConfig, AdamEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.standing import Standing, _values
from objgraph.estimate.task import Estimate
from objgraph.graph.builder import GraphConfig
from tests.objgraph.estimate.adam_cases import DIM, SMALL, UP, task
from tests.toys import toy_state

FLOOR = float(toy_state().T_world_object.translation()[2]) - 0.45
"""Under the toy chair's middle."""


def leaning(down: float = 0.05):
    """A chair that leans and has sunk."""
    delta = np.zeros(DIM)
    delta[0], delta[4] = 0.06, -down
    return toy_state().retract(delta)


@pytest.mark.parametrize("floor", [FLOOR, None])
def test_its_gradient_is_that_of_the_factors(floor):
    """Along every axis of the state through `retract`, by central differences of the factors' own errors."""
    standing = Standing(task(floor=floor))
    assert len(standing._floor) == (floor is not None)
    state = leaning()
    standing.refresh(state)
    delta = torch.zeros(DIM, dtype=torch.float64, requires_grad=True)
    loss = standing.loss(state, delta)
    loss.backward()

    def errors(at) -> float:
        return sum(factor.error(_values(at)) for factor in standing._factors)

    assert float(loss) == pytest.approx(errors(state), rel=1e-9)
    assert float(loss) > 0.1
    step = 1e-6
    numeric = [
        (errors(state.retract(step * e)) - errors(state.retract(-step * e))) / (2 * step) for e in np.eye(DIM)
    ]
    assert delta.grad is not None
    np.testing.assert_allclose(delta.grad.numpy(), numeric, rtol=2e-4, atol=2e-4 * np.abs(numeric).max())


def test_what_has_sunk_is_lifted_and_what_leans_is_set_upright():
    """Without any surface or ray, floor and gravity alone."""
    start = leaning()
    config = replace(SMALL, iterations=60, surface_weight=0.0, render_weight=0.0, uncertainty=False)
    height, lean = {}, {}
    for standing in (False, True):
        (found,) = AdamEstimator(replace(config, standing=standing)).estimate(
            [task(floor=FLOOR, starts=(start,))]
        )
        assert isinstance(found, Estimate)
        height[standing] = found.state.T_world_object.translation()[2]
        lean[standing] = np.arccos(found.state.T_world_object.rotation().matrix()[2, 1])
    assert height[True] > height[False] + 0.02
    assert lean[False] == pytest.approx(0.06, rel=1e-3)
    assert lean[True] < 0.03


def test_without_it_nothing_is_other():
    assert AdamConfig().standing is False
    assert Standing(task(floor=FLOOR))._factors[0].keys() == [task_keys()]


def task_keys() -> int:
    return gtsam.symbol("o", 0)


def test_a_bare_graph_is_told_neither_up_nor_floor():
    given = task(floor=FLOOR)
    bare = GraphEstimator(GraphConfig(sides=None), heading_modes=None, gravity=False)
    told = GraphEstimator(GraphConfig(sides=None), heading_modes=None)
    kinds = {}
    for name, estimator in (("bare", bare), ("told", told)):
        single = estimator._single(given, given.starts[0])
        attitudes = [
            f
            for i in range(single.graph.size())
            if isinstance(f := single.graph.at(i), gtsam.AttitudeFactorPose3)
        ]
        kinds[name] = (len(attitudes), sum(isinstance(f, FloorFactor) for f in single.factors))
    assert kinds == {"bare": (0, 0), "told": (1, 1)}
    other = replace(given, up_world=-UP, floor=7.0)
    a, b = (bare.estimate([each])[0] for each in (given, other))
    assert isinstance(a, Estimate)
    assert isinstance(b, Estimate)
    np.testing.assert_array_equal(a.state.T_world_object.matrix(), b.state.T_world_object.matrix())
