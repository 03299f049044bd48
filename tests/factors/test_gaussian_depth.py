"""The scores that an estimator by gradients follows, against sums, samples and differences of their own."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import expit
from scipy.stats import norm

from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, GaussianDepth, Probabilistic, Sampled, Uncentred
from factors.occupancy import depth_mean, total_depth_variance
from factors.rays import RayCells
from factors.rendering import ESCAPE, RaySamples, RayTargets
from factors.score import energy_score

PROBABILISTIC = [Probabilistic(moments) for moments in ("quadrature", "sobol")]
GAUSSIAN = [*PROBABILISTIC, Sampled(), Deterministic()]
FULL = [
    FullDistribution(),
    FullDistribution(reach=None),
]
SLOPE = 60.0
RAYS, SAMPLES = 6, 8


def scene(seed: int = 0, shift: float = 0.0) -> tuple[torch.Tensor, torch.Tensor, RayCells, RayTargets]:
    """Rays that a surface half stops, half of them hits; every second free ray ends before it has left the box."""
    rng = np.random.default_rng(seed)
    width = rng.uniform(0.03, 0.08, (RAYS, SAMPLES))
    edges = torch.as_tensor(shift + np.cumsum(np.c_[rng.uniform(1, 1.2, RAYS), width], axis=1))
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sdf = np.linspace(0.05, -0.03, SAMPLES) + 0.03 * rng.normal(size=(RAYS, SAMPLES))
    hit = torch.arange(RAYS) % 2 == 0
    end = torch.where(torch.arange(RAYS) % 4 == 1, cells.far - 0.05, cells.far + 0.3)
    depth = cells.depth[:, SAMPLES // 2] + 0.01
    targets = RayTargets(depth, hit, end, torch.full_like(end, 0.01))
    sigma = rng.uniform(0.01, 0.03, (RAYS, SAMPLES))
    return torch.as_tensor(sdf), torch.as_tensor(sigma), cells, targets


def nodes_of(renderer: GaussianDepth) -> tuple[np.ndarray, np.ndarray]:
    """Standard-normal nodes and weights: the 128 points of the paper's kind, or a rule far finer than is needed."""
    if isinstance(renderer, Probabilistic) and renderer.moments == "sobol":
        engine = torch.quasirandom.SobolEngine(1, scramble=True, seed=0)
        # quantiles of the occupancy, which falls where the SDF rises
        return -norm.ppf(engine.draw(128, dtype=torch.float64)[:, 0].numpy()), np.full(128, 1 / 128)
    x = np.linspace(-8, 8, 801)
    return x, norm.pdf(x) * (x[1] - x[0])


def depth_by_sums(renderer, sdf, sigma, depth, escape, slope):
    """Mean and variance of one ray's depth by the definitions, event by event."""
    x, weight = nodes_of(renderer)
    spread = sigma if isinstance(renderer, Probabilistic) else np.zeros_like(sigma)
    o = expit(-slope * (sdf[:, None] + spread[:, None] * x))
    ends = [*depth, escape]
    m = np.append(o @ weight / weight.sum(), 1.0)  # whoever has passed all samples escapes
    probability = [m[i] * np.prod(1 - m[:i]) for i in range(len(ends))]
    mean = sum(p * d for p, d in zip(probability, ends, strict=True))
    if isinstance(renderer, Deterministic):
        return mean, 0.0
    return mean, sum(p * (d - mean) ** 2 for p, d in zip(probability, ends, strict=True))


def score_by_sums(renderer, sdf, sigma, cells, targets, slope) -> np.ndarray:
    """The score of each ray; the energy score is that of a normal in its textbook form."""
    scores = np.zeros(len(sdf))
    for r in range(len(sdf)):
        far, hit = float(cells.far[r]), bool(targets.hit[r])
        if not hit and float(targets.end[r]) < far:
            continue
        depth, escape = cells.depth[r].numpy(), 1.1 * far
        mean, variance = depth_by_sums(renderer, sdf[r].numpy(), sigma[r].numpy(), depth, escape, slope)
        error, spread = mean - (float(targets.depth[r]) if hit else escape), max(np.sqrt(variance), 1e-6)
        z = error / spread
        scores[r] = spread * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    return scores


@pytest.mark.parametrize("renderer", GAUSSIAN)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_score_is_that_of_the_sums(renderer, seed):
    sdf, sigma, cells, targets = scene(seed)
    score = renderer.score(RaySamples(sdf, sigma, cells, targets, SLOPE))
    expected = score_by_sums(renderer, sdf, sigma, cells, targets, SLOPE)
    np.testing.assert_allclose(score.numpy(), expected, rtol=1e-6, atol=1e-9)
    assert (expected[~targets.hit.numpy()] == 0).any()
    assert (expected > 1e-3).any()


@pytest.mark.parametrize("renderer", GAUSSIAN)
def test_the_spread_that_is_frozen_has_the_sensor_s_variance_too(renderer):
    sdf, sigma, cells, targets = scene()
    escape = (1.1 * cells.far).tolist()
    for r, spread in enumerate(renderer.freeze(RaySamples(sdf, sigma, cells, targets, SLOPE)).tolist()):
        depth = cells.depth[r].numpy()
        _, variance = depth_by_sums(renderer, sdf[r].numpy(), sigma[r].numpy(), depth, escape[r], SLOPE)
        assert spread == pytest.approx(np.hypot(np.sqrt(variance), float(targets.sigma[r])), rel=1e-5)


def differences(function, values: torch.Tensor, step: float = 1e-6) -> np.ndarray:
    """Central differences of a sum w.r.t. every entry."""
    result = np.zeros(values.shape)
    for i in np.ndindex(*values.shape):
        up, down = values.clone(), values.clone()
        up[i] += step
        down[i] -= step
        result[i] = (float(function(up).sum()) - float(function(down).sum())) / (2 * step)
    return result


def gradients(renderer, sdf, sigma, cells, targets) -> tuple[np.ndarray, np.ndarray]:
    """Autograd's derivatives of all scores' sum w.r.t. the SDF and its deviation."""
    sdf, sigma = sdf.clone().requires_grad_(), sigma.clone().requires_grad_()
    score = renderer.score(RaySamples(sdf, sigma, cells, targets, SLOPE))
    d_sdf, d_sigma = torch.autograd.grad(score.sum(), [sdf, sigma], allow_unused=True)
    return d_sdf.numpy(), np.zeros(sdf.shape) if d_sigma is None else d_sigma.numpy()


@pytest.mark.parametrize("renderer", GAUSSIAN)
def test_derivatives_are_those_of_the_sums(renderer):
    sdf, sigma, cells, targets = scene()
    d_sdf, d_sigma = gradients(renderer, sdf, sigma, cells, targets)

    def by_sums(s, t):
        return score_by_sums(renderer, s, t, cells, targets, SLOPE)

    expected = differences(lambda s: by_sums(s, sigma), sdf)
    np.testing.assert_allclose(d_sdf, expected, rtol=1e-4, atol=1e-6)
    assert np.abs(expected).max() > 0.1
    if isinstance(renderer, Probabilistic):
        expected = differences(lambda t: by_sums(sdf, t), sigma)
        np.testing.assert_allclose(d_sigma, expected, rtol=1e-4, atol=1e-6)
        assert np.abs(expected).max() > 0.01
    else:
        assert (d_sigma == 0).all()


@pytest.mark.parametrize("renderer", FULL)
def test_derivatives_of_the_full_distribution_for_held_weights(renderer):
    sdf, sigma, cells, targets = scene()
    d_sdf, d_sigma = gradients(renderer, sdf, sigma, cells, targets)
    spread = renderer.freeze(RaySamples(sdf, sigma, cells, targets, SLOPE))

    def loss(s, t):
        return renderer.render(RaySamples(s, t, cells, targets, SLOPE), spread).loss

    torch.testing.assert_close(
        renderer.score(RaySamples(sdf, sigma, cells, targets, SLOPE)), loss(sdf, sigma)
    )
    for found, expected in (
        (d_sdf, differences(lambda s: loss(s, sigma), sdf)),
        (d_sigma, differences(lambda t: loss(sdf, t), sigma)),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-7)
        assert np.abs(expected).max() > 1e-3


def test_sampled_is_the_mean_and_spread_of_a_million_rays():
    renderer, rng = Sampled(), np.random.default_rng(0)
    sdf, sigma, cells, _ = scene()
    escape = ESCAPE * cells.far
    moments = renderer.occupancy(sdf, sigma, SLOPE)
    mean = depth_mean(moments.mean, cells.depth, escape)
    variance = total_depth_variance(moments.mean, cells.depth, escape)
    for r in range(RAYS):
        occupied = rng.random((1_000_000, SAMPLES), dtype=np.float32) < expit(-SLOPE * sdf[r].numpy())
        first = np.where(occupied.any(axis=1), occupied.argmax(axis=1), SAMPLES)
        ends = np.append(cells.depth[r].numpy(), float(escape[r]))[first]
        assert float(mean[r]) == pytest.approx(ends.mean(), abs=5 * ends.std() / 1000)
        assert float(variance[r]) == pytest.approx(ends.var(), rel=0.01)
        sums = depth_by_sums(
            renderer, sdf[r].numpy(), sigma[r].numpy(), cells.depth[r].numpy(), float(escape[r]), SLOPE
        )
        assert (float(mean[r]), float(variance[r])) == pytest.approx(sums, rel=1e-9)


def test_the_score_of_the_expected_depth_alone_is_its_absolute_error():
    sdf, sigma, cells, targets = scene()
    error, counts, _ = Deterministic().depth_error(RaySamples(sdf, sigma, cells, targets, SLOPE))
    score = Deterministic().score(RaySamples(sdf, sigma, cells, targets, SLOPE))
    torch.testing.assert_close(score, counts * error.abs(), rtol=0, atol=1e-6)
    assert float(score.max()) > 0.01


@pytest.mark.parametrize("renderer", PROBABILISTIC)
def test_without_uncertainty_the_papers_is_the_sampled_one(renderer):
    sdf, _, cells, targets = scene()
    certain = torch.zeros_like(sdf)
    papers, sampled = (each.occupancy(sdf, certain, SLOPE) for each in (renderer, Sampled()))
    torch.testing.assert_close(papers.mean, sampled.mean)
    samples = RaySamples(sdf, certain, cells, targets, SLOPE)
    torch.testing.assert_close(
        renderer.ray_variance(samples, papers), Sampled().ray_variance(samples, sampled)
    )
    torch.testing.assert_close(renderer.score(samples), Sampled().score(samples), rtol=0, atol=1e-6)


def test_sobol_points_do_what_the_quadrature_does():
    sdf, sigma, cells, targets = scene()
    for slope, tolerance in ((60.0, 2e-3), (400.0, 1e-2)):
        exact, points = (
            Probabilistic(moments).score(RaySamples(sdf, sigma, cells, targets, slope))
            for moments in ("quadrature", "sobol")
        )
        torch.testing.assert_close(points, exact, rtol=tolerance, atol=1e-4)


@pytest.mark.parametrize("renderer", PROBABILISTIC)
def test_a_certain_sample_is_one_of_tiny_uncertainty(renderer):
    sdf, sigma, cells, targets = scene()
    certain = torch.as_tensor(np.random.default_rng(0).random(sdf.shape) < 0.5)
    none, tiny = sigma.masked_fill(certain, 0.0), sigma.masked_fill(certain, 1e-9)
    found = renderer.score(RaySamples(sdf, none, cells, targets, SLOPE))
    torch.testing.assert_close(
        found, renderer.score(RaySamples(sdf, tiny, cells, targets, SLOPE)), rtol=1e-6, atol=1e-9
    )
    assert float((found - renderer.score(RaySamples(sdf, sigma, cells, targets, SLOPE))).abs().max()) > 1e-4
    d_sdf, d_sigma = gradients(renderer, sdf, none, cells, targets)
    expected, expected_sigma = gradients(renderer, sdf, tiny, cells, targets)
    np.testing.assert_allclose(d_sdf, expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(d_sigma[~certain], expected_sigma[~certain], rtol=1e-4, atol=1e-6)
    assert (d_sigma[certain] == 0).all()


@pytest.mark.parametrize("renderer", GAUSSIAN)
def test_where_rays_escape_and_what_a_free_ray_says(renderer):
    sdf, sigma, cells, targets = scene()
    empty, full = torch.full_like(sdf, 5.0), torch.full_like(sdf, -5.0)
    free = replace(targets, hit=torch.zeros(RAYS, dtype=torch.bool))
    # nothing in the way: the ray escapes at 1.1 times the box's far side, as a free ray should
    assert float(renderer.score(RaySamples(empty, sigma, cells, free, SLOPE)).max()) < 1e-6
    missed = renderer.score(RaySamples(empty, sigma, cells, replace(targets, hit=~free.hit), SLOPE))
    torch.testing.assert_close(missed, 1.1 * cells.far - targets.depth, rtol=0, atol=1e-6)
    # all in the way: it ends at the first sample, which a hit and a free ray each compare with their own depth
    stopped = renderer.score(RaySamples(full, sigma, cells, replace(targets, hit=~free.hit), SLOPE))
    torch.testing.assert_close(stopped, targets.depth - cells.depth[:, 0], rtol=0, atol=1e-6)
    seen_through = free.end >= cells.far
    stopped = renderer.score(RaySamples(full, sigma, cells, free, SLOPE))
    torch.testing.assert_close(
        stopped, seen_through * (1.1 * cells.far - cells.depth[:, 0]), rtol=0, atol=1e-6
    )
    # one that ends within the box says nothing, whatever is there
    assert seen_through.any()
    assert not seen_through.all()
    d_sdf, d_sigma = gradients(renderer, sdf, sigma, cells, free)
    assert (d_sdf[~seen_through] == 0).all()
    assert (d_sigma[~seen_through] == 0).all()
    assert (np.abs(d_sdf[seen_through]).max(axis=1) > 0.01).all()
    # how far a hit could have been seen is of no matter
    near = replace(targets, end=torch.where(targets.hit, targets.depth, targets.end))
    torch.testing.assert_close(
        renderer.score(RaySamples(sdf, sigma, cells, near, SLOPE)),
        renderer.score(RaySamples(sdf, sigma, cells, targets, SLOPE)),
    )


@pytest.mark.parametrize("renderer", [*PROBABILISTIC, Sampled()])
@pytest.mark.parametrize("shift", [-0.9, 3.0, 40.0])
def test_moving_the_scene_along_the_ray_changes_no_variance(renderer, shift):
    sdf, sigma, cells, _ = scene()
    moments = renderer.occupancy(sdf, sigma, SLOPE)
    escape = ESCAPE * cells.far
    here = total_depth_variance(moments.mean, cells.depth, escape)
    there = total_depth_variance(moments.mean, cells.depth + shift, escape + shift)
    assert float(here.min()) > 1e-5
    torch.testing.assert_close(there, here, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("renderer", [*PROBABILISTIC, Sampled()])
def test_variances_bear_single_precision(renderer):
    """Depths of metres and spreads of millimetres, in the decoder's precision."""
    rng = np.random.default_rng(0)
    depth = torch.as_tensor(2.5 + 0.02 * np.arange(50))[None]
    sdf = torch.as_tensor(3.0 - depth.numpy() + 0.001 * rng.normal(size=(1, 50)))
    sigma, escape = torch.full_like(sdf, 0.004), torch.tensor([3.8]).double()
    occupancy = renderer.occupancy(sdf, sigma, 400.0).mean
    exact = total_depth_variance(occupancy, depth, escape)
    found = total_depth_variance(occupancy.float(), depth.float(), escape.float())
    assert float(found) == pytest.approx(float(exact), rel=1e-3)


@pytest.mark.parametrize("renderer", [*GAUSSIAN, *FULL])
def test_scores_and_derivatives_are_finite_where_nothing_is_uncertain_or_near(renderer):
    """Gradients in single precision, of rays that saturate: none may be NaN."""
    _, _, cells, targets = scene()
    cells = RayCells(cells.depth.float(), cells.width.float(), cells.far.float())
    targets = RayTargets(targets.depth.float(), targets.hit, targets.end.float(), targets.sigma.float())
    for value in (-1.0, -1e-3, 0.0, 1e-3, 1.0):
        for spread in (0.0, 1e-6, 0.3):
            sdf = torch.full((RAYS, SAMPLES), value, requires_grad=True)
            sigma = torch.full((RAYS, SAMPLES), spread, requires_grad=True)
            score = renderer.score(RaySamples(sdf, sigma, cells, targets, 400.0))
            found = torch.autograd.grad(score.sum(), [sdf, sigma], allow_unused=True)
            assert torch.isfinite(score).all()
            assert all(g is None or bool(torch.isfinite(g).all()) for g in found)


def test_the_uncentred_variance_is_that_of_each_end_over_shared_draws():
    """The released program's, draw by draw and sample by sample, and its score."""
    sdf, sigma, cells, targets = scene()
    sigma[0], sigma[1, :3] = 0.0, 0.0  # a ray that is certain, and one that is in part
    samples, renderer = RaySamples(sdf, sigma, cells, targets, SLOPE), Uncentred()
    x, _ = nodes_of(renderer)
    expected, escape = np.zeros(RAYS), samples.escape.numpy()
    for r in range(RAYS):
        ends = np.append(cells.depth[r].numpy(), escape[r])
        occupied = expit(-SLOPE * (sdf[r].numpy()[:, None] + sigma[r].numpy()[:, None] * x))
        weights = np.zeros((len(ends), len(x)))
        for j in range(len(x)):
            passed = 1.0
            for k in range(SAMPLES):
                weights[k, j] = passed * occupied[k, j]
                passed *= 1 - occupied[k, j]
            weights[-1, j] = passed
        expected[r] = np.sum(ends**2 * weights.var(axis=1))
    moments = renderer.occupancy(sdf, sigma, SLOPE)
    np.testing.assert_allclose(
        renderer.ray_variance(samples, moments).numpy(), expected, rtol=1e-5, atol=1e-12
    )
    assert expected[0] < 1e-12 < 0.1 < expected[1:].min()
    error, counts, _ = Probabilistic(moments="sobol").depth_error(samples)
    score = counts * energy_score(error, torch.as_tensor(expected).clamp_min(1e-12).sqrt())
    torch.testing.assert_close(renderer.score(samples), score, rtol=1e-5, atol=1e-9)
    # unlike a variance it depends on where the scene is
    away = replace(samples, cells=RayCells(cells.depth + 5, cells.width, cells.far + 5))
    assert (renderer.ray_variance(away, moments)[1:] > 4 * torch.as_tensor(expected[1:])).all()


@pytest.mark.parametrize("renderer", [Uncentred(), Deterministic(squared_up_to=0.01)])
def test_derivatives_of_the_released_scores(renderer):
    sdf, sigma, cells, targets = scene()
    d_sdf, d_sigma = gradients(renderer, sdf, sigma, cells, targets)

    def score(s, t):
        return renderer.score(RaySamples(s, t, cells, targets, SLOPE))

    expected = differences(lambda s: score(s, sigma), sdf)
    np.testing.assert_allclose(d_sdf, expected, rtol=1e-4, atol=1e-6)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(d_sigma, differences(lambda t: score(sdf, t), sigma), rtol=1e-4, atol=1e-6)


def test_squares_are_clamped_and_then_have_no_gradient():
    sdf, sigma, cells, targets = scene()
    samples = RaySamples(sdf.requires_grad_(), sigma, cells, targets, SLOPE)
    error, counts, d_error = Deterministic().depth_error(samples)
    bound = float(error.detach()[counts > 0].square().median())
    score = Deterministic(squared_up_to=bound).score(samples)
    torch.testing.assert_close(score, counts * error.square().clamp(max=bound))
    (gradient,) = torch.autograd.grad(score.sum(), sdf)
    below = counts * (error.square() < bound)
    torch.testing.assert_close(gradient[below > 0], (2 * error[:, None] * d_error)[below > 0])
    clamped = (counts > 0) & (error.square() > bound)
    assert clamped.any()
    assert (gradient[clamped] == 0).all()
