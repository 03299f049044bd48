"""What the released programs do otherwise: each option by its definition."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from factors.gaussian_depth import Probabilistic
from factors.rendering import CLEAR
from factors.state import RIGID_DOF
from objgraph.bench.comparison.contenders.methods import (
    GN_SHORT,
    METHODS,
    RELEASED_DIFFERENCES,
    method,
    released,
)
from objgraph.bench.comparison.objects.config import settings_of
from objgraph.errors import SolveError
from objgraph.estimate import AdamConfig, AdamEstimator, GaussNewtonEstimator
from objgraph.estimate.adam import clip_groups, own_from_world_scale
from objgraph.estimate.gauss_newton import huber_weight
from objgraph.estimate.pool import Pool
from objgraph.estimate.task import Estimate
from objgraph.estimate.terms import RaySteps, draw_rays
from tests.objgraph.estimate.adam_cases import (
    DECODER,
    DIM,
    GAUSS_NEWTON,
    OFF,
    SMALL,
    VARIANCE,
    descent,
    drawn_at_start,
    loss_and_gradients,
    result,
    task,
    views,
)
from tests.objgraph.estimate.adam_reference import Reference, canonical_sdf
from tests.toys import toy_state

GROUPS = (slice(0, 6), slice(6, 9), slice(9, None))
SOBOL = Probabilistic(moments="sobol")


def entries(settings, name: str = "") -> dict[str, object]:
    """Settings as one flat table."""
    if not isinstance(settings, dict):
        return {name: settings}
    return {k: v for key, item in settings.items() for k, v in entries(item, f"{name}.{key}").items()}


def changes(name: str, base: str) -> set[str]:
    one, other = (entries(settings_of(method(each).estimator())) for each in (name, base))
    return {key for key in one.keys() | other.keys() if one.get(key) != other.get(key)}


def test_a_method_is_known_by_what_it_is_released_as():
    assert [released(name) for name in ("ours", "ours@own", "dsp-slam-gn", "ours-det2d", "graph", "ours-released")] == [
        "ours-released", "ours-released@own", "dsp-slam-gn-released", "ours-det2d-released", "graph", "ours-released",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("bases", "whole"),
    [(["ours"], "ours-released"), (["dsp-slam-gn-undamped", "dsp-slam-gn"], "dsp-slam-gn-released")],
)
def test_the_released_method_has_every_difference_and_no_other(bases, whole):
    """From the first of its bases on."""
    single = [name for name in RELEASED_DIFFERENCES if name.partition("+")[0] in bases]
    assert len(single) >= 5
    each = [changes(name, name.partition("+")[0]) for name in single]
    assert all(each)
    assert sum(map(len, each)) == len(set.union(*each))
    assert set.union(*each) == changes(whole, bases[0])
    assert not set(single) & set(METHODS)


def test_the_baseline_of_all_tables_is_the_one_that_is_damped():
    """As that of the speed bench is; what overflows is compared under a name that says so."""
    assert changes("dsp-slam-gn", "dsp-slam-gn-undamped") == {".config.damping", ".config.huber"}
    undamped = METHODS["dsp-slam-gn-undamped"].estimator()
    assert isinstance(undamped, GaussNewtonEstimator)
    assert undamped.config.damping == 0
    assert undamped.config.huber is None
    # the samples and iterations of the speed bench's are others
    assert changes(GN_SHORT, "dsp-slam-gn") == {".config.iterations", ".config.points", ".config.rays"}
    assert changes("dsp-slam-gn-released", "dsp-slam-gn") == {
        ".config.iterations",
        ".config.one_scale",
        ".config.one_view",
    }


def test_the_released_deterministic_method_squares_and_has_no_variance():
    ours = changes("ours-released", "ours") - changes("ours+depth-variance", "ours")
    squared = changes("ours-det2d+squared", "ours-det2d")
    assert squared
    assert changes("ours-det2d-released", "ours-det2d") == ours | squared


def test_each_group_of_a_gradient_is_clipped_by_itself():
    rng = np.random.default_rng(0)
    before = torch.as_tensor(rng.normal(size=(3, DIM)) * np.array([1e-3, 0.05, 10.0])[:, None])
    before[2, GROUPS[1]] = 0.0
    after = before.clone()
    clip_groups(after, 0.1)
    for group in GROUPS:
        norm = before[:, group].norm(dim=1, keepdim=True)
        torch.testing.assert_close(after[:, group].norm(dim=1, keepdim=True), norm.clamp(max=0.1))
        torch.testing.assert_close(after[:, group] * norm, before[:, group] * norm.clamp(max=0.1))


def test_a_descent_clips_both_leaves():
    found = descent(replace(SMALL, clip=0.1), SOBOL, task())
    free = descent(SMALL, SOBOL, task())
    pools, rays = drawn_at_start(found)
    _, *clipped = loss_and_gradients(found, pools, rays)
    _, *whole = loss_and_gradients(free, pools, rays)
    for one, other in zip(clipped, whole, strict=True):
        for group in GROUPS:
            shortened = min(1.0, 0.1 / np.linalg.norm(other[group]))
            np.testing.assert_allclose(one[group], shortened * other[group], rtol=1e-9, atol=1e-15)
    assert np.linalg.norm(whole[0]) > 1


def test_as_released_the_log_variances_shrink_by_about_one():
    """All the way that Adam's rate lets them, as was seen of the released program; ours go half as far."""
    moved = {}
    for name in ("ours", "ours-released"):
        estimator = method(name).estimator()
        assert isinstance(estimator, AdamEstimator)
        config = replace(estimator.config, points=60, rays=40)
        found = result(task(), replace(estimator, config=config))
        assert found.covariance is not None
        first = np.array([config.pose_variance] * RIGID_DOF + [config.code_variance] * (DIM - RIGID_DOF))
        log = np.log(np.diag(found.covariance.matrix) / first)
        moved[name] = np.array([log[group].mean() for group in GROUPS])
    assert ((moved["ours-released"] > -1.2) & (moved["ours-released"] < -0.7)).all()
    assert (moved["ours"] > -0.75).all()


@pytest.mark.parametrize("canonical", [True, False])
def test_band_samples_lie_about_the_first_crossing(canonical):
    state, band = toy_state().retract(OFF), 0.025
    steps = RaySteps(samples=60, band=band, canonical_band=canonical, band_samples=20)
    pool = Pool.of(views())
    (drawn,) = draw_rays(DECODER, [state], [pool], steps)
    (stepped,) = draw_rays(DECODER, [state], [pool], replace(steps, band_samples=None))
    assert drawn.sdf.shape == (len(stepped.sdf), 20)
    near, far = pool.rays.interval(state)
    meets = (far - near > 1e-3) & (pool.rays.end > near)
    rays = pool.rays.take(np.flatnonzero(meets | pool.rays.hit))
    depth = drawn.cells.depth.numpy()
    p_world = rays.at(depth)
    crosses = (stepped.sdf < 0).any(dim=1).numpy()
    assert crosses.mean() > 0.3
    # the ends are the band away from the middle, and the middle is on the surface to within a coarse step's curvature
    ends = p_world[:, [0, -1]]
    if canonical:
        ends = state.to_object(ends.reshape(-1, 3)).reshape(-1, 2, 3)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    np.testing.assert_allclose(length[crosses], 2 * band * 19 / 20)
    middle = canonical_sdf(state, rays.at(depth.mean(axis=1)[:, None])[:, 0])
    assert np.median(np.abs(middle[crosses])) < 1e-3
    assert np.abs(middle[crosses]).max() < 0.02
    # no earlier step is inside, and what never is is looked at where it comes nearest
    first = (stepped.sdf < 0).double().argmax(dim=1).numpy()
    step = stepped.cells.depth.numpy()[np.arange(len(first)), first]
    assert (np.abs(depth.mean(axis=1) - step) <= stepped.cells.width.numpy()[:, 0] + 1e-9)[crosses].all()
    passes = ~crosses & (stepped.sdf != CLEAR).any(dim=1).numpy()
    nearest = stepped.cells.depth.numpy()[np.arange(len(first)), stepped.sdf.argmin(dim=1).numpy()]
    np.testing.assert_allclose(depth.mean(axis=1)[passes], nearest[passes])
    # near is what is within the band
    values = canonical_sdf(state, p_world.reshape(-1, 3)).reshape(depth.shape)
    unit = 1.0 if canonical else np.exp(state.log_scale.mean())
    assert (np.abs(values[drawn.near.numpy()]) * unit < band).all()
    assert drawn.near.double().mean() > 0.2


def test_the_first_views_interval_serves_all_rays():
    state, pool = toy_state().retract(OFF), Pool.of(views())
    steps = RaySteps(samples=30, first_view_depths=True)
    (drawn,) = draw_rays(DECODER, [state], [pool], steps)
    count = len(views()[0].rays.depth)
    np.testing.assert_array_equal(pool.rays.first_view, np.arange(len(pool.rays.depth)) < count)
    near, far = (ends[:count] for ends in pool.rays.interval(state))
    crosses = far - near > 1e-3
    edges = np.linspace(near[crosses].min(), far[crosses].max(), 31)
    meets = (drawn.sdf != CLEAR).any(dim=1).numpy()
    expected = np.broadcast_to(0.5 * (edges[1:] + edges[:-1]), (meets.sum(), 30))
    np.testing.assert_allclose(drawn.cells.depth.numpy()[meets], expected)
    assert (drawn.cells.far.numpy()[meets] == far[crosses].max()).all()
    # of a draw without rays of the first view each keeps its own
    others = replace(pool, rays=pool.rays.take(~pool.rays.first_view))
    (kept,), (own,) = (
        draw_rays(DECODER, [state], [others], each)
        for each in (steps, replace(steps, first_view_depths=False))
    )
    torch.testing.assert_close(kept.cells.depth, own.cells.depth)


def test_world_scale_is_the_diagonal_of_the_stretch_seen_from_the_object():
    state = toy_state(0.7).retract(OFF)
    R = state.T_world_object.rotation().matrix()
    s = np.array([0.1, -0.2, 0.05])
    np.testing.assert_allclose(own_from_world_scale(state) @ s, np.diag(R.T @ np.diag(s) @ R))
    # at right angles it is the stretch itself
    level = toy_state(np.pi / 2)
    stretched = level.retract(np.r_[np.zeros(6), own_from_world_scale(level) @ s, np.zeros(DIM - RIGID_DOF)])
    p = np.random.default_rng(0).normal(size=(5, 3))
    centre = level.T_world_object.translation()
    np.testing.assert_allclose(stretched.to_world(p) - centre, np.exp(s) * (level.to_world(p) - centre))


def test_loss_gradient_and_step_along_the_worlds_axes():
    one, config = task(0.7), replace(SMALL, world_scale=True)
    found = descent(config, SOBOL, one)
    pools, rays = drawn_at_start(found)
    loss, d_state, d_variance = loss_and_gradients(found, pools, rays)
    reference = Reference(one, config, SOBOL, pools[0].p_world, rays[0])
    along = np.eye(DIM)
    along[6:9, 6:9] = own_from_world_scale(one.starts[0])
    reference.jacobian = {name: J @ along for name, J in reference.jacobian.items()}
    assert loss == pytest.approx(reference.loss(np.zeros(DIM), VARIANCE), rel=1e-5)
    expected = reference.differences(lambda delta: reference.loss(along @ delta, VARIANCE), np.zeros(DIM))
    np.testing.assert_allclose(d_state, expected, atol=2e-4 * np.abs(expected).max())
    expected = reference.differences(
        lambda log: reference.loss(np.zeros(DIM), np.exp(log)), np.log(VARIANCE), step=1e-4
    )
    np.testing.assert_allclose(d_variance, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())
    step = np.linspace(-0.1, 0.1, DIM)
    with torch.no_grad():
        found.delta.copy_(torch.as_tensor(step))
    found._move()
    np.testing.assert_allclose(found.states[0].matrix, one.starts[0].retract(along @ step).matrix)
    estimate = found._result(0, 0.0, 0.0)
    assert not isinstance(estimate, Exception)
    assert estimate.covariance is not None
    own = own_from_world_scale(found.states[0])
    np.testing.assert_allclose(
        np.diag(estimate.covariance.matrix)[6:9], np.diag(own @ np.diag(VARIANCE[6:9]) @ own.T)
    )


def test_huber_weights_are_the_derivative_of_hubers_loss_over_the_error():
    error = np.array([-0.3, -0.05, -0.01, 0.0, 0.02, 0.0500001, 1.0])

    def loss(e):
        return np.where(np.abs(e) < 0.05, 0.5 * e**2, 0.05 * (np.abs(e) - 0.025))

    weight = huber_weight(error, 0.05)
    np.testing.assert_allclose(weight * error, (loss(error + 1e-7) - loss(error - 1e-7)) / 2e-7, atol=1e-6)
    np.testing.assert_allclose(0.5 * weight * (2 - weight) * error**2, loss(error), atol=1e-12)
    assert (huber_weight(error, None) == 1).all()


def normal_equations(estimator: GaussNewtonEstimator, one, state):
    pool = Pool.of(one.views).draw(np.random.default_rng(0), 60, 40)
    (rays,) = draw_rays(DECODER, [one.starts[0]], [pool], estimator.config.steps)
    return estimator._normal_equations(one, state, pool, rays)


def test_gauss_newton_follows_hubers_loss():
    one = task()
    config = replace(GAUSS_NEWTON.config, huber=0.02, render_weight=0.0)
    estimator, start = GaussNewtonEstimator(config), one.starts[0]
    cost, _, gradient = normal_equations(estimator, one, start)
    squares, *_ = normal_equations(GAUSS_NEWTON, one, start)
    assert cost < squares
    pool = Pool.of(one.views).draw(np.random.default_rng(0), 60, 40)
    (rays,) = draw_rays(DECODER, [start], [pool], config.steps)
    reference = Reference(one, AdamConfig(uncertainty=False), SOBOL, pool.p_world, rays)

    def loss(delta):
        e = reference.sdf("surface", delta)
        rho = np.where(np.abs(e) < 0.02, 0.5 * e**2, 0.02 * (np.abs(e) - 0.01))
        code = start.retract(delta).code - one.prior.code_mean
        return 100 * rho.mean() + 0.125 * code @ code

    assert cost == pytest.approx(loss(np.zeros(DIM)), rel=1e-6)
    expected = reference.differences(loss, np.zeros(DIM))
    np.testing.assert_allclose(gradient, expected, atol=1e-4 * np.abs(expected).max())


def test_a_damped_step_solves_the_damped_equations_and_is_shorter():
    one = task()
    _, H, gradient = normal_equations(GAUSS_NEWTON, one, one.starts[0])
    damped = GaussNewtonEstimator(replace(GAUSS_NEWTON.config, damping=3.0))._step(H, gradient)
    np.testing.assert_allclose((H + 3 * np.eye(DIM)) @ damped, -gradient, atol=1e-9)
    assert np.linalg.norm(damped) < np.linalg.norm(GAUSS_NEWTON._step(H, gradient))


def test_one_scale_keeps_the_starts_ratios():
    one = task()
    estimator = GaussNewtonEstimator(replace(GAUSS_NEWTON.config, one_scale=True))
    _, H, gradient = normal_equations(estimator, one, one.starts[0])
    step = estimator._step(H, gradient)
    # the least of the quadratic over seven degrees of freedom and the code
    along = np.delete(np.eye(DIM), [7, 8], axis=1)
    along[6:9, 6] = 1.0
    np.testing.assert_allclose(along.T @ (H @ step + gradient), 0, atol=1e-8)
    found = result(one, estimator).state.log_scale - one.starts[0].log_scale
    assert np.abs(found).max() > 1e-3
    assert np.ptp(found) < 1e-12


def test_rays_of_one_view_are_the_first_views():
    one = task()
    estimator = GaussNewtonEstimator(replace(GAUSS_NEWTON.config, one_view=True, points=10**6, rays=10**6))
    rays = replace(views()[1].rays, depth=views()[1].rays.depth + 0.5)
    other = replace(one, views=(views()[0], replace(views()[1], rays=rays)))
    np.testing.assert_array_equal(result(one, estimator).state.matrix, result(other, estimator).state.matrix)
    all_views = replace(estimator, config=replace(estimator.config, one_view=False))
    assert np.abs(result(one, all_views).state.matrix - result(other, all_views).state.matrix).max() > 1e-3
    assert np.abs(result(one, estimator).state.matrix - result(one, all_views).state.matrix).max() > 1e-6


def test_gauss_newtons_failures_are_its_results():
    """No surface point, and steps that lead beyond all numbers: the other object of the batch is estimated."""
    (view, *_) = views()
    bare = replace(view, points_camera=np.zeros((0, 3)), points_sigma=np.zeros(0))
    far = toy_state().retract(np.r_[np.zeros(6), np.full(3, 300.0), np.zeros(DIM - 9)])
    tasks = [task(views=(bare,)), task(starts=(far,)), task()]
    without, beyond, good = GAUSS_NEWTON.estimate(tasks)
    assert "no view has a surface point" in str(without)
    assert isinstance(beyond, SolveError)
    assert isinstance(good, Estimate)
