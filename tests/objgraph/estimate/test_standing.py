"""Up and the floor, told to the estimators that follow gradients as the graph is told, and kept from the graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.floor import FloorFactor
from factors.gaussian_depth import Probabilistic
from objgraph.bench.comparison.contenders.methods import METHODS, method
from objgraph.errors import SolveError
from objgraph.estimate import AdamEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.standing import Standing
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.builder import RENDERERS, GraphConfig, ObjectBuilder
from objgraph.graph.single_object import ALONE
from tests.objgraph.estimate.adam_cases import (
    DIM,
    OFF,
    SMALL,
    UP,
    descent,
    drawn_at_start,
    loss_and_gradients,
    result,
    task,
)
from tests.toys import toy_prior, toy_state

BOX = np.array([0.6, 0.85, 0.6])


@pytest.mark.parametrize("renderer", RENDERERS)
def test_whatever_renders_its_views_an_object_in_the_floor_is_pushed_up(renderer):
    builder = ObjectBuilder(GraphConfig(renderer=renderer), UP, 0.0)
    (factor,) = builder.standing(toy_prior(), ALONE)  # which has no feet
    low = toy_state()
    low = replace(low, T_world_object=gtsam.Pose3(low.T_world_object.rotation(), 0.1 * UP))
    values = gtsam.Values()
    low.insert(values, ALONE)
    factor.refresh(values)
    rows = factor.rows(values)
    gradient = low.T_world_object.rotation().matrix() @ (rows.residual @ rows.jacobian).numpy()[3:6]
    assert gradient @ UP < -1


def standing_task(floor: float | None = 0.0, **changes) -> EstimationTask:
    """A chair that has feet, 6 cm too low."""
    low = toy_state().retract(OFF)
    T = low.T_world_object
    low = replace(low, T_world_object=gtsam.Pose3(T.rotation(), T.translation() - [0, 0, 0.06]))
    one = task(starts=(low,), floor=floor)
    return replace(one, prior=replace(one.prior, box=BOX), **changes)


def errors(standing: Standing, state) -> float:
    values = gtsam.Values()
    state.insert(values, ALONE)
    return sum(factor.error(values) for factor in standing.factors)


@pytest.mark.parametrize("floor", [0.0, None])
@pytest.mark.parametrize("world_scale", [False, True])
def test_the_added_loss_and_its_gradient_are_the_factors(floor, world_scale):
    one, config = standing_task(floor), replace(SMALL, world_scale=world_scale)
    told, untold = (
        descent(replace(config, standing=standing), Probabilistic(), one) for standing in (True, False)
    )
    drawn = drawn_at_start(untold)
    told.standing[0].refresh(one.starts[0])
    loss, d_state, d_variance = loss_and_gradients(told, *drawn)
    bare, d_bare, d_bare_variance = loss_and_gradients(untold, *drawn)
    factors = told.standing[0]
    assert len(factors.factors) == (2 if floor is not None else 1)
    assert loss - bare == pytest.approx(errors(factors, one.starts[0]), rel=1e-5)
    np.testing.assert_array_equal(d_variance, d_bare_variance)
    along, step = np.eye(DIM), 1e-5
    if world_scale:
        along[6:9, 6:9] = np.square(one.starts[0].T_world_object.rotation().matrix()).T
    expected = np.array(
        [
            (
                errors(factors, one.starts[0].retract(step * axis))
                - errors(factors, one.starts[0].retract(-step * axis))
            )
            / (2 * step)
            for axis in along.T
        ]
    )
    np.testing.assert_allclose(d_state - d_bare, expected, atol=1e-3 * np.abs(expected).max())
    assert np.abs(expected[:3]).max() > 1
    if floor is not None:
        assert np.abs(expected[3:6]).max() > 1


def test_the_factors_are_the_graphs():
    one = standing_task()
    builder = ObjectBuilder(up_world=UP, floor=0.0)
    graph = builder.alone(one.prior, one.starts[0], one.views)
    theirs = next(factor for factor in graph.factors if isinstance(factor, FloorFactor))
    theirs.refresh(graph.values)
    upright = next(
        graph.graph.at(i)
        for i in range(graph.graph.size())
        if isinstance(graph.graph.at(i), gtsam.MagPoseFactorPose3)
    )
    ours = Standing(one, 400.0)
    ours.refresh(one.starts[0])
    expected = theirs.loss(graph.values) + upright.error(graph.values)
    assert errors(ours, one.starts[0]) == pytest.approx(expected, rel=1e-9)


def test_an_object_below_the_floor_is_lifted():
    """Of nothing but the floor and the lean, and against what the views say of it."""
    one = standing_task()
    blind = replace(SMALL, iterations=60, surface_weight=0.0, render_weight=0.0)

    def height(config) -> float:
        return float(result(one, AdamEstimator(config)).state.T_world_object.translation()[2])

    low, true = one.starts[0].T_world_object.translation()[2], toy_state().T_world_object.translation()[2]
    assert height(blind) == pytest.approx(low, abs=0.01)
    assert height(replace(blind, standing=True)) > low + 0.03
    seen = replace(SMALL, iterations=60, points=100, rays=80)
    assert abs(height(replace(seen, standing=True)) - true) < abs(height(seen) - true) + 0.005


def test_a_state_that_is_no_number_fails_alone():
    lost = replace(standing_task().starts[0], log_scale=np.full(3, np.nan))
    estimator = AdamEstimator(replace(SMALL, standing=True))
    failed, found = estimator.estimate([standing_task(starts=(lost,), name="lost"), standing_task()])
    assert "lost" in str(failed)
    assert isinstance(found, Estimate)
    alone = result(standing_task(), estimator)
    np.testing.assert_allclose(found.state.matrix, alone.state.matrix, atol=1e-9)


def test_without_gravity_the_graph_is_told_neither_up_nor_the_floor():
    one = standing_task()
    bare, told = method("graph-bare").estimator(), method("graph").estimator()
    assert isinstance(bare, GraphEstimator)
    assert isinstance(told, GraphEstimator)
    assert bare.heading_modes is None
    assert bare.graph.sides is None
    kinds = []
    for estimator in (bare, told):
        begun = estimator._begun(one)
        assert not isinstance(begun, SolveError)
        single = begun.tried[0]
        attitude = [
            isinstance(single.graph.at(i), gtsam.MagPoseFactorPose3) for i in range(single.graph.size())
        ]
        kinds.append((any(attitude), any(isinstance(factor, FloorFactor) for factor in single.factors)))
    assert kinds == [(False, False), (True, True)]
    blind = replace(one, up_world=None, floor=None)
    quick = replace(bare, solver=replace(bare.solver, rounds=2))
    np.testing.assert_array_equal(result(one, quick).state.matrix, result(blind, quick).state.matrix)


def test_what_is_given_is_what_an_estimator_uses():
    assert METHODS["graph"].given == ("floor", "upright", "filled box", "heading modes")
    assert METHODS["ours-floor"].given == ("floor", "upright")
    assert METHODS["graph-bare"].given == METHODS["ours"].given == METHODS["dsp-slam-gn-released"].given == ()
    for each in METHODS.values():
        estimator = each.estimator()
        if isinstance(estimator, AdamEstimator):
            assert ("floor" in each.given) == estimator.config.standing
        if isinstance(estimator, GraphEstimator):
            assert ("floor" in each.given) == estimator.gravity
            assert ("filled box" in each.given) == (estimator.graph.sides is not None)
            assert ("heading modes" in each.given) == (estimator.heading_modes is not None)
