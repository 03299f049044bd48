"""Incremental updates on a plain pose graph: equal to batch, and taken back whole where they fail."""

import gc

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import O, X

from objgraph.errors import SolveError
from objgraph.slam.incremental.smoother import Smoother, determined

STEP = gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.array([0.5, 0.1, 0.0]))
NOISE = gtsam.noiseModel.Diagonal.Sigmas([0.02] * 3 + [0.05] * 3)


def prior(key: int) -> gtsam.NonlinearFactor:
    return gtsam.PriorFactorPose3(key, gtsam.Pose3(), NOISE)


def between(a: int, b: int, motion: gtsam.Pose3 = STEP) -> gtsam.NonlinearFactor:
    return gtsam.BetweenFactorPose3(a, b, motion, NOISE)


def value(key: int, pose: gtsam.Pose3) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(key, pose)
    return values


def walk(count: int, lag: float | None = None) -> tuple[Smoother, gtsam.NonlinearFactorGraph]:
    """A chain of noisy steps, and the same factors in one graph."""
    rng = np.random.default_rng(3)
    smoother, graph = Smoother(lag, relinearize=1e-6), gtsam.NonlinearFactorGraph()
    for k in range(count):
        factor = between(X(k - 1), X(k), STEP.retract(rng.normal(size=6) * 0.02)) if k else prior(X(0))
        pose = smoother.pose(X(k - 1)).compose(STEP) if k else gtsam.Pose3()
        smoother.update([factor], value(X(k), pose), newest=X(k), times={X(k): float(k)})
        graph.push_back(factor)
    return smoother, graph


def optimum(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    return gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()


def assert_is_optimum(smoother: Smoother, graph: gtsam.NonlinearFactorGraph) -> None:
    found = smoother.estimate()
    best = optimum(graph, found)
    for key in best.keys():  # noqa: SIM118
        np.testing.assert_allclose(found.atPose3(key).matrix(), best.atPose3(key).matrix(), atol=1e-5)


def _settle(smoother: Smoother) -> None:
    for _ in range(6):
        smoother.update()


def test_incremental_is_batch():
    smoother, graph = walk(12)
    closing = between(X(0), X(11), gtsam.Pose3(gtsam.Rot3.Rz(3.0), np.array([0.2, 2.0, 0.0])))
    smoother.update([closing], newest=X(11))
    graph.push_back(closing)
    _settle(smoother)
    assert_is_optimum(smoother, graph)
    keys = [X(3), X(11)]
    joint = gtsam.Marginals(graph, smoother.estimate()).jointMarginalCovariance(gtsam.KeyVector(keys))
    np.testing.assert_allclose(smoother.covariance(keys), joint.fullMatrix(), rtol=1e-3, atol=1e-7)


def test_marginal_factors_stand_for_the_rest_of_the_system():
    smoother, _ = walk(8)
    keys = [X(2), X(6)]
    alone = gtsam.NonlinearFactorGraph()
    for factor in smoother.marginal_factors(keys):
        alone.push_back(factor)
    assert set(alone.keyVector()) == set(keys)
    values = smoother.estimate().extract(gtsam.KeyVector(keys))
    moved = optimum(alone, values.retract(_nudge(values)))
    for key in keys:
        np.testing.assert_allclose(moved.atPose3(key).matrix(), smoother.pose(key).matrix(), atol=1e-4)
    np.testing.assert_allclose(
        gtsam.Marginals(alone, values).jointMarginalCovariance(gtsam.KeyVector(keys)).fullMatrix(),
        smoother.covariance(keys), rtol=1e-6, atol=1e-9,
    )  # fmt: skip


def _nudge(values: gtsam.Values) -> gtsam.VectorValues:
    delta = gtsam.VectorValues()
    for key in values.keys():  # noqa: SIM118
        delta.insert(key, np.full(6, 0.05))
    return delta


def test_a_factor_taken_out_is_forgotten():
    smoother, graph = walk(6)
    (number,) = smoother.update([between(X(0), X(5), gtsam.Pose3())], newest=X(5))
    assert np.linalg.norm(smoother.pose(X(5)).translation()) < 1.5
    smoother.update(remove=[number])
    _settle(smoother)
    assert not smoother.holds(number)
    assert_is_optimum(smoother, graph)


class _Broken(Exception):
    pass


def _raising(key: int) -> gtsam.NonlinearFactor:
    def error(this, values, H):
        raise _Broken("this factor is broken")

    return gtsam.CustomFactor(NOISE, gtsam.KeyVector([key]), error)


@pytest.mark.parametrize("lag", [None, 100.0])
@pytest.mark.parametrize("fault", ["exception", "singular"])
def test_a_failed_update_is_taken_back(fault, lag):
    smoother, graph = walk(6, lag)
    (kept,) = smoother.update([prior(X(4))])
    _settle(smoother)
    before = smoother.estimate()
    bad = _raising(X(5)) if fault == "exception" else between(X(8), X(9))
    values = gtsam.Values()
    times = {}
    if fault == "singular":
        values.insert(X(8), gtsam.Pose3())
        values.insert(X(9), gtsam.Pose3())
        times = {X(8): 8.0, X(9): 9.0}
    with pytest.raises(SolveError, match="taken back"):
        smoother.update([bad], values, remove=[kept], newest=X(5), times=times)
    after = smoother.estimate()
    assert sorted(after.keys()) == sorted(before.keys())
    for key in before.keys():  # noqa: SIM118
        np.testing.assert_allclose(after.atPose3(key).matrix(), before.atPose3(key).matrix(), atol=1e-4)
    # and it goes on as if nothing had been
    smoother.update(remove=[kept])
    smoother.update([between(X(5), X(6))], value(X(6), after.atPose3(X(5))), newest=X(6), times={X(6): 6.0})
    graph.push_back(between(X(5), X(6)))
    _settle(smoother)
    assert_is_optimum(smoother, graph)


@pytest.mark.parametrize("lag", [None, 100.0])
def test_a_failed_update_moves_nothing_where_a_loop_was_just_closed(lag):
    """It would have linearised anew what the loop has moved, before it failed."""
    smoother, _ = walk(20, lag)
    gap = smoother.pose(X(0)).between(smoother.pose(X(19)))
    elsewhere = gap.compose(gtsam.Pose3(gtsam.Rot3.Rz(0.2), np.array([0.5, -0.3, 0.1])))
    smoother.update([between(X(0), X(19), elsewhere)], newest=X(19))
    before = smoother.estimate()
    with pytest.raises(SolveError, match="taken back"):
        smoother.update([_raising(X(19))], newest=X(19))
    after = smoother.estimate()
    for k in range(20):
        np.testing.assert_allclose(after.atPose3(X(k)).matrix(), before.atPose3(X(k)).matrix(), atol=1e-6)


def test_behind_the_lag_variables_are_marginalised_out():
    smoother, graph = walk(12, lag=4.5)
    assert not smoother.has(X(2))
    assert smoother.has(X(8))
    assert not smoother.holds(0)
    best = optimum(graph, _chain(12))
    np.testing.assert_allclose(smoother.pose(X(11)).matrix(), best.atPose3(X(11)).matrix(), atol=1e-3)
    full = gtsam.Marginals(graph, best).marginalCovariance(X(11))
    # what went past the lag keeps the linearisation point that it had then
    np.testing.assert_allclose(smoother.covariance([X(11)]), full, atol=0.03 * full.max())


def _chain(count: int) -> gtsam.Values:
    values, pose = gtsam.Values(), gtsam.Pose3()
    for k in range(count):
        values.insert(X(k), pose)
        pose = pose.compose(STEP)
    return values


def test_what_is_not_there_is_named():
    smoother, _ = walk(3)
    with pytest.raises(SolveError, match="x7"):
        smoother.covariance([X(1), X(7)])
    with pytest.raises(SolveError, match="x7"):
        smoother.marginal_factors([X(7)])


def far_start() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """A loop whose first guess is bent."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(prior(X(0)))
    for k in range(6):
        graph.push_back(between(X(k), X((k + 1) % 6), gtsam.Pose3(gtsam.Rot3.Rz(np.pi / 3), [1.0, 0, 0])))
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3.Rz(0.7 * k), np.array([0.8 * k, 0.3, 0.1 * k])))
    return graph, values


def test_every_step_linearises_anew():
    """GTSAM's own default is every tenth."""
    graph, values = far_start()
    factors = [graph.at(i) for i in range(graph.size())]
    best = optimum(graph, values)
    smoother, plain = Smoother(relinearize=1e-6), gtsam.ISAM2()
    smoother.update(factors, values)
    plain.update(graph, values)
    for _ in range(7):
        smoother.update()
        plain.update()
    cost = graph.error(best)
    assert graph.error(smoother.estimate()) < cost + 1e-6
    assert graph.error(plain.calculateEstimate()) > cost + 1e-3


def test_settling_goes_to_the_optimum_at_once_and_numbers_stay():
    graph, values = far_start()
    smoother = Smoother()
    numbers = smoother.update([graph.at(i) for i in range(graph.size())], values)
    smoother.update(remove=[numbers[2]])
    (again,) = smoother.update([graph.at(2)])
    smoother.settle()
    assert_is_optimum(smoother, graph)
    assert all(smoother.holds(number) for number in (again, *numbers[3:]))
    # and it goes on from there
    smoother.update(remove=[again])
    smoother.settle()
    graph.remove(2)
    assert_is_optimum(smoother, graph)


def test_settling_behind_a_lag_keeps_what_was_marginalised():
    smoother, graph = walk(12, lag=4.5)
    before = smoother.covariance([X(11)])
    smoother.settle()
    assert not smoother.has(X(2))
    # what went past the lag keeps its linearisation point; the rest has a new one
    np.testing.assert_allclose(smoother.covariance([X(11)]), before, atol=0.03 * before.max())
    best = optimum(graph, _chain(12))
    np.testing.assert_allclose(smoother.pose(X(11)).matrix(), best.atPose3(X(11)).matrix(), atol=1e-3)
    smoother.update(
        [between(X(11), X(12))], value(X(12), smoother.pose(X(11))), newest=X(12), times={X(12): 12.0}
    )
    assert smoother.has(X(12))


def test_settling_nothing_does_nothing():
    smoother = Smoother()
    smoother.settle()
    assert smoother.estimate().size() == 0


def affected(poses: int, grouped: bool) -> int:
    """Variables that the next camera's factor would eliminate anew, where one object has been seen from all before."""
    smoother = Smoother(relinearize=10.0)
    smoother.update([prior(X(0))], value(X(0), gtsam.Pose3()), newest=X(0))
    seen = value(O(0), gtsam.Pose3())
    for k in range(1, poses):
        step = value(X(k), smoother.pose(X(k - 1)).compose(STEP))
        if k == 1:
            step.insert(seen)
        newest = X(k) if grouped else None
        smoother.update([between(X(k - 1), X(k)), between(X(k), O(0))], step, newest=newest)
    new = gtsam.NonlinearFactorGraph()
    new.push_back(between(X(poses - 1), X(poses)))
    values = value(X(poses), smoother.pose(X(poses - 1)))
    keys, _ = smoother._isam.predictUpdateInfo(new, values, gtsam.ISAM2UpdateParams())
    return keys.size()


def test_what_the_next_camera_touches_does_not_grow_with_the_map():
    """The newest camera is eliminated last; left to itself, GTSAM may have it anywhere."""
    assert affected(40, grouped=True) == affected(160, grouped=True) < 6 < affected(160, grouped=False)


def test_what_was_asked_for_does_not_change_with_later_steps():
    """GTSAM's linearisation point and factors are the system's own, and change under whoever holds them."""
    smoother, _ = walk(8)
    held = smoother._isam.getLinearizationPoint()
    keys, estimate = [X(2), X(6)], smoother.estimate()
    marginal, covariance = smoother.marginal_factors(keys), smoother.covariance(keys)
    poses = [smoother.pose(key) for key in keys]
    values = estimate.extract(gtsam.KeyVector(keys))
    copy, kept = gtsam.Values(values), covariance.copy()
    errors = [factor.error(values) for factor in marginal]
    size = held.size()
    closing = between(X(0), X(7), gtsam.Pose3(gtsam.Rot3.Rz(1.0), np.array([0.2, 2.0, 0.0])))
    smoother.update([closing, between(X(7), X(8))], value(X(8), gtsam.Pose3()), newest=X(8))
    _settle(smoother)
    assert held.size() == size + 1
    smoother.settle()
    del held
    gc.collect()
    assert not smoother.estimate().extract(gtsam.KeyVector(keys)).equals(copy, 1e-3)
    assert estimate.extract(gtsam.KeyVector(keys)).equals(copy, 0.0)
    assert [factor.error(values) for factor in marginal] == errors
    np.testing.assert_array_equal(covariance, kept)
    for key, pose in zip(keys, poses, strict=True):
        assert pose.equals(copy.atPose3(key), 0.0)


@pytest.mark.parametrize("lag", [None, 100.0])
def test_a_slot_that_is_used_again_does_not_confuse_the_factors(lag):
    smoother, graph = walk(6, lag)
    (first,) = smoother.update([between(X(0), X(5), gtsam.Pose3())], newest=X(5))
    smoother.update(remove=[first])
    (second,) = smoother.update([prior(X(4))])
    (third,) = smoother.update([prior(X(3))])
    assert len({first, second, third}) == 3
    assert not smoother.holds(first)
    with pytest.raises(SolveError, match="not in the incremental system any more"):
        smoother.update(remove=[first])
    smoother.update(remove=[second])
    graph.push_back(prior(X(3)))
    _settle(smoother)
    assert_is_optimum(smoother, graph)
    smoother.update(remove=[third])
    graph.remove(graph.size() - 1)
    _settle(smoother)
    assert_is_optimum(smoother, graph)


def test_what_gtsam_cannot_determine_is_named():
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(between(X(0), X(1)))
    values = value(X(0), gtsam.Pose3())
    values.insert(X(1), STEP)

    def query(keys: gtsam.KeyVector) -> gtsam.JointMarginal:
        return gtsam.Marginals(graph, values).jointMarginalCovariance(keys)

    with pytest.raises(SolveError, match=r"x0, x1: the incremental system hardly determines them"):
        determined([X(0), X(1)], query)
