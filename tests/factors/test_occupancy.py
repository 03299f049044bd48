import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import expit
from scipy.stats import norm

from factors.occupancy import (
    PROBIT_SCALE,
    OccupancyMoments,
    depth_mean,
    depth_mean_gradient,
    occupancy_quantile,
    probit_occupancy,
    quadrature_moments,
    sobol_moments,
    termination,
    total_depth_variance,
)

CASES = [(mu, sigma) for mu in (-0.05, -0.004, 0.0, 0.01, 0.03) for sigma in (0.001, 0.01, 0.03)]
SLOPE = 400.0


@pytest.mark.parametrize(("mu", "sigma"), CASES)
def test_moments_of_the_logit_normal(mu, sigma):
    def moment(power):
        def integrand(s):
            return expit(-SLOPE * s) ** power * norm.pdf(s, mu, sigma)

        return quad(integrand, mu - 10 * sigma, mu + 10 * sigma, points=[0.0, mu], limit=500)[0]

    arguments = torch.tensor(mu).double(), torch.tensor(sigma).double(), SLOPE
    for estimate, tolerance in ((quadrature_moments(*arguments), 5e-3), (sobol_moments(*arguments), 2e-2)):
        assert float(estimate.mean) == pytest.approx(moment(1), abs=tolerance)
        assert float(estimate.second) == pytest.approx(moment(2), abs=tolerance)
    tau = (sigma**2 + (PROBIT_SCALE / SLOPE) ** 2) ** 0.5
    closed = probit_occupancy(arguments[0], torch.tensor(tau).double())
    assert float(closed) == pytest.approx(moment(1), abs=0.015)


@pytest.mark.parametrize(("mu", "sigma"), CASES)
def test_quantile_inverts_the_distribution(mu, sigma):
    u = torch.tensor([0.01, 0.3, 0.5, 0.9]).double()
    o = occupancy_quantile(u, torch.tensor(mu).double(), torch.tensor(sigma).double(), SLOPE)
    log_odds = torch.log(o) - torch.log1p(-o)
    inside = (o > 1e-12) & (o < 1 - 1e-12)
    # P(occupancy <= o) = P(sdf >= -logit(o) / l)
    probability = norm.sf(-log_odds[inside].numpy() / SLOPE, mu, sigma)
    np.testing.assert_allclose(probability, u[inside], atol=1e-4)


def test_mean_gradient_is_exact_for_the_quadrature():
    mu = torch.linspace(-0.03, 0.03, 9).double().requires_grad_()
    moments = quadrature_moments(mu, torch.full_like(mu, 0.01), SLOPE)
    (expected,) = torch.autograd.grad(moments.mean.sum(), mu)
    torch.testing.assert_close(moments.d_mean(SLOPE).detach(), expected)


def _ray(seed=0, samples=6):
    generator = torch.Generator().manual_seed(seed)
    mu = torch.linspace(0.04, -0.03, samples).double()[None]
    sigma = 0.01 + 0.01 * torch.rand(1, samples, generator=generator).double()
    depth = torch.linspace(1.0, 1.2, samples).double()[None]
    return mu, sigma, depth, torch.tensor([1.4]).double()


def test_depth_moments_are_those_of_a_million_samples():
    mu, sigma, depth, escape = _ray()
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(1_000_000, mu.shape[1], generator=generator).double()
    probability, escaped = termination(torch.sigmoid(-SLOPE * (mu + sigma * noise)))
    torch.testing.assert_close(probability.sum(dim=1) + escaped, torch.ones(1_000_000).double())
    expected_depth = (probability * depth).sum(dim=1) + escaped * escape
    occupancy = quadrature_moments(mu, sigma, SLOPE).mean
    mean = expected_depth.mean()
    assert float(depth_mean(occupancy, depth, escape)) == pytest.approx(float(mean), abs=5e-4)
    squares = (probability * (depth - mean) ** 2).sum(dim=1) + escaped * (escape - mean) ** 2
    variance = float(total_depth_variance(occupancy, depth, escape))
    assert variance == pytest.approx(float(squares.mean()), rel=0.03)


def test_moving_the_scene_along_the_ray_does_not_change_the_variance():
    mu, sigma, depth, escape = _ray()
    occupancy = quadrature_moments(mu, sigma, SLOPE).mean
    here, there = (depth_mean(occupancy, depth + by, escape + by) for by in (0, 7))
    torch.testing.assert_close(there, here + 7)
    here, there = (total_depth_variance(occupancy, depth + by, escape + by) for by in (0, 7))
    torch.testing.assert_close(there, here)


def test_depth_gradient_is_autograds():
    mu, sigma, depth, escape = _ray()
    occupancy = quadrature_moments(mu, sigma, SLOPE).mean.requires_grad_()
    probability, escaped = termination(occupancy)
    mean = (probability * depth).sum(dim=1) + escaped * escape
    (expected,) = torch.autograd.grad(mean.sum(), occupancy)
    torch.testing.assert_close(depth_mean_gradient(occupancy.detach(), depth, escape), expected)


occupancies = st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=12)


def _moments(drawn: list[tuple[float, float]]) -> OccupancyMoments:
    """Those of a ray whose means are given, and whose variances are a share of the largest there can be."""
    mean, share = torch.tensor(drawn, dtype=torch.float64).T[:, None]
    return OccupancyMoments(mean, mean**2 + share * mean * (1 - mean))


@given(occupancies)
def test_termination_probabilities_sum_to_one(drawn):
    probability, escaped = termination(_moments(drawn).mean)
    assert probability.shape == (1, len(drawn))
    assert float(probability.sum() + escaped) == pytest.approx(1)
    assert (probability >= 0).all()


@given(occupancies, st.floats(0.5, 5), st.floats(0.01, 0.3))
def test_mean_and_total_variance_are_those_of_where_the_ray_ends(drawn, first, step):
    mean = _moments(drawn).mean
    ends = first + step * np.arange(len(drawn) + 1)
    probability, passed = [], 1.0
    for o, _ in drawn:
        probability.append(o * passed)
        passed *= 1 - o
    probability = np.array([*probability, passed])
    depth, escape = torch.as_tensor(ends[:-1])[None], torch.as_tensor(ends[-1:])
    expected = float(probability @ ends)
    assert float(depth_mean(mean, depth, escape)) == pytest.approx(expected)
    variance = float(total_depth_variance(mean, depth, escape))
    assert variance == pytest.approx(float(probability @ (ends - expected) ** 2), abs=1e-12)
