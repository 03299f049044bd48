"""Every derivative of the gradient-based estimators against a loss that is written anew."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import torch

from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
from factors.sdf import metres_per_unit, query_points, sdf_jacobian
from objgraph.estimate import AdamConfig, GaussNewtonEstimator, terms
from objgraph.estimate.adam import _Descent
from objgraph.estimate.pool import Pool
from objgraph.estimate.terms import DrawnRays, Linearized, RaySteps, draw_rays, linearize
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
)
from tests.objgraph.estimate.adam_reference import Reference, canonical_sdf, depth_errors, metres_at
from tests.toys import ToyDecoder, toy_state

LOSSES = [
    (SMALL, Probabilistic()),
    (SMALL, Probabilistic(moments="sobol")),
    (SMALL, Sampled()),
    (SMALL, Deterministic()),
    (replace(SMALL, surface_weight=0.0, code_weight=0.0), Probabilistic()),
    (replace(SMALL, render_weight=0.0), Probabilistic()),
    (replace(SMALL, uncertainty=False), Deterministic()),
    (replace(SMALL, uncertainty=False, surface_weight=0.0), Sampled()),
]


@pytest.mark.parametrize(("config", "renderer"), LOSSES)
def test_loss_and_gradients_are_those_of_the_papers_loss(config, renderer):
    """eq:final_loss, moved through `retract` and through the logarithms of its variances."""
    one = task()
    found = descent(config, renderer, one)
    pools, rays = drawn_at_start(found)
    loss, d_state, d_variance = loss_and_gradients(found, pools, rays)
    reference = Reference(one, config, renderer, pools[0].p_world, rays[0])
    assert loss == pytest.approx(reference.loss(np.zeros(DIM), VARIANCE), rel=1e-5)
    expected = reference.differences(lambda delta: reference.loss(delta, VARIANCE), np.zeros(DIM))
    scale = np.abs(expected).max()
    assert scale > 0.1
    np.testing.assert_allclose(d_state, expected, atol=2e-4 * scale)
    if not config.uncertainty:
        assert (d_variance == 0).all()
        return
    expected = reference.differences(
        lambda log: reference.loss(np.zeros(DIM), np.exp(log)), np.log(VARIANCE), step=1e-4
    )
    assert np.abs(expected).min() > 0
    np.testing.assert_allclose(d_variance, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("renderer", [Probabilistic(), Sampled(), Deterministic()])
@pytest.mark.parametrize("uncertainty", [True, False])
def test_single_precision_gives_the_same_gradients(renderer, uncertainty):
    config = replace(SMALL, uncertainty=uncertainty)
    double, single = (
        loss_and_gradients(found, *drawn_at_start(found))
        for found in (
            descent(config, renderer, task(decoder=decoder)) for decoder in (DECODER, ToyDecoder().float())
        )
    )
    assert single[0] == pytest.approx(double[0], rel=1e-4)
    for one, other in zip(single[1:], double[1:], strict=True):
        assert np.linalg.norm(one - other) <= 1e-3 * np.linalg.norm(other)


def test_linearized_points_are_those_of_single_objects(monkeypatch):
    """Decoded together and in pieces, each point is of its own object; one object may have none."""
    monkeypatch.setattr(terms, "CHUNK", 7)
    rng = np.random.default_rng(0)
    states = [toy_state(0.4).retract(OFF), toy_state(2.0, (0, 0.5, 0, 0)), toy_state(-1.0)]
    points = [
        state.to_world(rng.uniform(-0.5, 0.5, (n, 3))) for state, n in zip(states, (20, 0, 11), strict=True)
    ]
    together = linearize(DECODER, states, points)
    for state, p_world, found in zip(states, points, together, strict=True):
        query = query_points(DECODER, state, gtsam.Pose3(), p_world)
        jet = DECODER.linearize(query.p_object, query.code[None])
        metres = metres_per_unit(jet.d_point, state)
        torch.testing.assert_close(found.sdf, metres * jet.value)
        torch.testing.assert_close(found.jacobian, metres[:, None] * sdf_jacobian(query, jet, camera=False))
        assert found.jacobian.shape == (len(p_world), DIM)
        if len(p_world):
            held, step = metres_at(state, p_world), 1e-6
            np.testing.assert_allclose(found.sdf, held * canonical_sdf(state, p_world), rtol=1e-4, atol=1e-7)
            for axis, column in zip(np.eye(DIM), found.jacobian.numpy().T, strict=True):
                up, down = (canonical_sdf(state.retract(sign * step * axis), p_world) for sign in (1, -1))
                np.testing.assert_allclose(column, held * (up - down) / (2 * step), rtol=1e-3, atol=1e-5)


def with_all_samples(found: _Descent, pool: Pool, drawn: DrawnRays, near: np.ndarray) -> DrawnRays:
    """The same rays with other samples differentiated."""
    start, end = pool.rays.interval(found.states[0])
    kept = pool.rays.take(np.flatnonzero((end - start > 1e-3) & (pool.rays.end > start)))
    return replace(drawn, near=torch.as_tensor(near), p_near=kept.at(drawn.cells.depth.numpy())[near])


@pytest.mark.parametrize("renderer", [Probabilistic(), Sampled(), Deterministic()])
@pytest.mark.parametrize("heading", [0.4, 2.0])
@pytest.mark.parametrize("left_out", ["beyond reach", "all"])
def test_the_samples_left_out_would_change_nothing(renderer, heading, left_out):
    """The 2D term's gradient with more samples differentiated, at the paper's first variances."""
    config = replace(SMALL, rays=150, surface_weight=0.0, code_weight=0.0, steps=RaySteps())
    found = _Descent([task(heading)], config, renderer)
    (pool,), (few,) = drawn_at_start(found)
    _, *some = loss_and_gradients(found, [pool], [few])
    more = (
        np.abs(few.sdf.numpy()) < config.steps.band if left_out == "beyond reach" else np.ones(few.near.shape)
    )
    more = more.astype(bool)
    assert few.near.sum() < 0.9 * more.sum()
    _, *full = loss_and_gradients(found, [pool], [with_all_samples(found, pool, few, more)])
    for part, whole in zip(some, full, strict=True):
        assert np.linalg.norm(part - whole) <= 0.01 * np.linalg.norm(whole)


def test_the_papers_estimate_of_the_score_tends_to_the_closed_form():
    closed = descent(replace(SMALL, render_weight=0.0), Probabilistic(), task())
    pools, rays = drawn_at_start(closed)
    expected = loss_and_gradients(closed, pools, rays)
    errors = []
    for samples in (100, 100_000):
        config = replace(SMALL, render_weight=0.0, monte_carlo=samples)
        found = loss_and_gradients(descent(config, Probabilistic(), task()), pools, rays)
        assert found[0] == pytest.approx(expected[0], rel=3 / np.sqrt(samples))
        pairs = zip(found[1:], expected[1:], strict=True)
        errors.append([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in pairs])
    assert max(errors[-1]) < 0.02
    assert (np.array(errors[0]) > np.array(errors[-1])).all()


def test_gauss_newton_follows_the_gradient_of_half_its_squares():
    one, config = task(), replace(GAUSS_NEWTON.config, code_weight=2.0)
    pool = Pool.of(one.views).draw(np.random.default_rng(0), config.points, config.rays)
    (rays,) = draw_rays(DECODER, [one.starts[0]], [pool], config.steps)
    cost, H, gradient = GaussNewtonEstimator(config)._normal_equations(one, one.starts[0], pool, rays)
    reference = Reference(one, AdamConfig(uncertainty=False), Deterministic(), pool.p_world, rays)

    def residuals(delta):
        sdf, sigma = reference.along_rays("near", delta, VARIANCE)
        error, _ = depth_errors(Deterministic(), sdf, sigma, rays, config.steps.slope)
        code = reference.state.retract(delta).code - one.prior.code_mean
        return np.concatenate(
            [
                np.sqrt(config.surface_weight / config.points) * reference.sdf("surface", delta),
                np.sqrt(config.render_weight / config.rays) * np.nan_to_num(error),
                np.sqrt(config.code_weight) * code,
            ]
        )

    def half_square(delta):
        return 0.5 * np.sum(residuals(delta) ** 2)

    assert cost == pytest.approx(half_square(np.zeros(DIM)), rel=1e-6)
    expected = reference.differences(half_square, np.zeros(DIM))
    np.testing.assert_allclose(gradient, expected, atol=1e-4 * np.abs(expected).max())
    J = np.stack([(residuals(1e-6 * e) - residuals(-1e-6 * e)) / 2e-6 for e in np.eye(DIM)], axis=1)
    np.testing.assert_allclose(H, J.T @ J, atol=1e-3 * np.abs(H).max())
    # one full step, and the code's pull towards the prior's mean
    found = result(one, GaussNewtonEstimator(replace(config, iterations=1)))
    expected = one.starts[0].retract(-np.linalg.solve(H, gradient))
    np.testing.assert_allclose(found.state.matrix, expected.matrix, atol=1e-9)
    np.testing.assert_allclose(found.state.code, expected.code, atol=1e-9)


def test_surface_and_rays_share_one_decoding():
    """What is linearised of points and rays together is what each would be by itself."""
    one = task()
    found = descent(SMALL, Probabilistic(), one)
    pools, rays = drawn_at_start(found)
    loss, d_state, d_variance = loss_and_gradients(found, pools, rays)
    surface, near = (linearize(DECODER, found.states, [p])[0] for p in (pools[0].p_world, rays[0].p_near))
    again = descent(SMALL, Probabilistic(), one)
    value = again._loss(0, Linearized(surface.sdf, surface.jacobian), near, rays[0], 0)
    gradients = torch.autograd.grad(value, [again.delta, again.log_variance])
    assert float(value) == pytest.approx(loss)
    np.testing.assert_allclose(gradients[0][0], d_state, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(gradients[1][0], d_variance, rtol=1e-9, atol=1e-12)
