"""The paper's estimator and DSP-SLAM's Gauss-Newton: estimates come nearer, repeat, and do not depend on company."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from factors.gaussian_depth import Probabilistic
from factors.state import RIGID_DOF
from objgraph.bench.comparison.contenders.methods import METHODS
from objgraph.estimate import AdamEstimator, GaussNewtonConfig, GaussNewtonEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate
from tests.objgraph.estimate.adam_cases import (
    DIM,
    GAUSS_NEWTON,
    SMALL,
    descent,
    drawn_at_start,
    loss_and_gradients,
    pose_error,
    quick,
    result,
    task,
)
from tests.toys import TOY_CODE, ToyDecoder, toy_state


@pytest.mark.parametrize(
    "estimator", [AdamEstimator(SMALL), AdamEstimator(replace(SMALL, monte_carlo=50)), GaussNewtonEstimator()]
)
def test_together_each_is_estimated_as_if_alone(estimator):
    if isinstance(estimator, GaussNewtonEstimator):
        estimator = GaussNewtonEstimator(GaussNewtonConfig(iterations=4, points=60, rays=40))
    other = ToyDecoder().double()
    tasks = [task(0.4), task(2.0, other), task(2.0)]
    together = estimator.estimate(tasks)
    for one, found in zip(tasks, together, strict=True):
        alone = result(one, estimator)
        assert isinstance(found, Estimate)
        assert np.abs(found.state.code - one.starts[0].code).max() > 1e-3
        np.testing.assert_allclose(found.state.matrix, alone.state.matrix, atol=1e-5)
        np.testing.assert_allclose(found.state.code, alone.state.code, atol=1e-5)
        assert found.cost_final == pytest.approx(alone.cost_final, rel=1e-5)
        if alone.covariance is not None:
            assert found.covariance is not None
            np.testing.assert_allclose(found.covariance.matrix, alone.covariance.matrix, rtol=1e-5)


@pytest.mark.parametrize("name", [name for name in METHODS if not name.startswith("start")])
def test_every_method_comes_nearer(name):
    one, told = task(), []
    estimator = quick(name)
    (found,) = estimator.estimate([one], lambda done, total: told.append((done, total)))
    assert isinstance(found, Estimate)
    began = found.cost_initial
    if isinstance(estimator, GraphEstimator):  # whose last minimisation begins near the end
        seen = one if estimator.gravity else replace(one, up_world=None, floor=None)
        begin = estimator._single(seen, one.starts[0])
        assert found.cost_final < found.cost_initial
        began = begin.refreshed_cost(estimator.solver.slopes[-1])
    assert found.cost_final < 0.8 * began
    assert pose_error(found.state) < pose_error(one.starts[0])
    assert told
    assert told == sorted(told)
    assert told[-1][0] <= told[-1][1]
    assert found.linearizations > 0
    assert (found.covariance is None) == (name.startswith("dsp-slam") or name == "node-slam")


def test_the_covariance_is_diagonal_labelled_and_learnt():
    found = result(task(), AdamEstimator(SMALL))
    assert found.covariance is not None
    assert found.covariance.source == "adam"
    assert len(found.covariance.axes) == DIM
    matrix = found.covariance.matrix
    assert matrix.shape == (DIM, DIM)
    np.testing.assert_array_equal(matrix, np.diag(np.diag(matrix)))
    start = np.array([SMALL.pose_variance] * RIGID_DOF + [SMALL.code_variance] * TOY_CODE)
    # Adam's first steps are as long as the learning rate, here of the logarithms
    moved = np.log(np.diag(matrix) / start)
    assert (np.abs(moved) > 0.5 * SMALL.learning_rate).all()
    assert (np.abs(moved) < 2 * SMALL.learning_rate * SMALL.iterations).all()
    assert found.linearizations == SMALL.iterations
    assert result(task(), AdamEstimator(replace(SMALL, uncertainty=False))).covariance is None


def test_the_first_step_is_as_long_as_the_learning_rate():
    """Adam's first step is its rate against the gradient's sign, taken along the tangent at the start."""
    one, config = task(), replace(SMALL, iterations=1)
    found = descent(config, Probabilistic(moments="sobol"), one)
    with torch.no_grad():
        found.log_variance.copy_(
            torch.tensor([1e-4] * RIGID_DOF + [1e-6] * TOY_CODE, dtype=torch.float64).log()
        )
    _, gradient, _ = loss_and_gradients(found, *drawn_at_start(found))
    expected = one.starts[0].retract(-config.learning_rate * np.sign(gradient))
    state = result(one, AdamEstimator(config)).state
    np.testing.assert_allclose(state.matrix, expected.matrix, atol=1e-6)
    np.testing.assert_allclose(state.code, expected.code, atol=1e-6)


def test_an_object_that_no_ray_meets_is_still_drawn_by_its_points():
    start = toy_state()
    away = replace(start, T_world_object=start.T_world_object.retract(np.array([0, 0, 0, 0, 3.0, 0])))
    found = result(task(starts=(away,)), AdamEstimator(SMALL))
    assert found.cost_final < found.cost_initial


@pytest.mark.parametrize("estimator", [AdamEstimator(SMALL), GAUSS_NEWTON])
def test_the_same_seed_gives_the_same_result_and_another_another(estimator):
    one, two = (result(task(), estimator) for _ in range(2))
    np.testing.assert_array_equal(one.state.matrix, two.state.matrix)
    np.testing.assert_array_equal(one.state.code, two.state.code)
    assert (one.cost_initial, one.cost_final) == (two.cost_initial, two.cost_final)
    if one.covariance is not None:
        assert two.covariance is not None
        np.testing.assert_array_equal(one.covariance.matrix, two.covariance.matrix)
    other = result(task(), replace(estimator, config=replace(estimator.config, seed=1)))
    assert np.abs(other.state.matrix - one.state.matrix).max() > 1e-6
