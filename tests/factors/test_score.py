import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from factors.score import (
    bounded_score,
    bounded_slope,
    cauchy_root,
    cauchy_score,
    energy_score,
    energy_score_monte_carlo,
    majorizing_weight,
    unit_information_weight,
)

mus = st.floats(-3, 3)
sigmas = st.floats(0.01, 3)


def t(x: float) -> torch.Tensor:
    return torch.tensor(x, dtype=torch.float64)


@given(mus, sigmas)
def test_closed_form_is_the_integral_of_the_squared_distribution_error(mu, sigma):
    below = quad(lambda d: norm.cdf(d, mu, sigma) ** 2, mu - 12 * sigma, 0)[0] if mu - 12 * sigma < 0 else 0.0
    above = quad(lambda d: norm.sf(d, mu, sigma) ** 2, 0, mu + 12 * sigma)[0] if mu + 12 * sigma > 0 else 0.0
    assert float(energy_score(t(mu), t(sigma))) == pytest.approx(below + above, rel=1e-5, abs=1e-7)


def test_closed_form_is_the_papers_monte_carlo():
    mu, sigma = torch.tensor([0.0, 0.02, -0.3, 1.0]).double(), torch.tensor([0.1, 0.01, 0.3, 0.5]).double()
    estimate = energy_score_monte_carlo(mu, sigma, samples=1_000_000)
    torch.testing.assert_close(estimate, energy_score(mu, sigma), rtol=5e-3, atol=0)


def test_the_monte_carlo_estimate_is_its_seed_s_and_in_its_input_s_precision():
    mu, sigma = torch.tensor([0.1, -0.2]), torch.tensor([0.1, 0.3])
    one, again, other = (energy_score_monte_carlo(mu, sigma, 10, seed) for seed in (0, 0, 1))
    assert one.dtype == torch.float32
    assert torch.equal(one, again)
    assert not torch.equal(one, other)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_weight_is_right_where_mu_is_next_to_nothing(dtype):
    x = torch.logspace(-12, -1, 200, dtype=torch.float64)
    true = math.sqrt(2 / math.pi) * (1 - x**2 / 6 + x**4 / 40 - x**6 / 336)  # the series of erf
    found = majorizing_weight(x.to(dtype), torch.tensor(1.0, dtype=dtype))
    assert found.dtype == dtype
    torch.testing.assert_close(found.double(), true, rtol=4 * torch.finfo(dtype).eps + 2e-11, atol=0)


@given(mus, sigmas)
def test_the_weight_times_mu_is_the_gradient(mu, sigma):
    x = t(mu).requires_grad_()
    (gradient,) = torch.autograd.grad(energy_score(x, t(sigma)), x)
    assert float(majorizing_weight(t(mu), t(sigma)) * mu) == pytest.approx(float(gradient), abs=1e-6)


@given(mus, sigmas, st.floats(-5, 5))
def test_the_weight_majorizes(mu, sigma, other):
    weight = float(majorizing_weight(t(mu), t(sigma)))
    tangent = float(energy_score(t(mu), t(sigma))) + 0.5 * weight * (other**2 - mu**2)
    assert float(energy_score(t(other), t(sigma))) <= tangent + 1e-7 * (1 + tangent)


@given(st.floats(0.01, 3))
def test_curvature_at_the_minimum_is_the_information(sigma):
    weight = majorizing_weight(t(0.0), t(sigma)) * unit_information_weight(t(sigma))
    assert float(weight) == pytest.approx(1 / sigma**2)
    assert float(majorizing_weight(t(0.0), t(sigma))) == pytest.approx(math.sqrt(2 / math.pi) / sigma)


@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(0.5, 5))
def test_cauchys_root_touches_its_score_and_lies_above_it(r, other, tail):
    r, other = (
        torch.tensor(r, dtype=torch.float64, requires_grad=True),
        torch.tensor(other, dtype=torch.float64),
    )
    score, weight = cauchy_score(r, tail), cauchy_root(r, tail).square()
    (gradient,) = torch.autograd.grad(score, r)
    torch.testing.assert_close(gradient, (weight * r).detach())
    quadratic = score + weight * (other.square() - r.square()) / 2
    assert float(quadratic) >= float(cauchy_score(other, tail)) - 1e-9
    assert float(cauchy_score(other, tail)) <= float(other.square()) / 2 + 1e-12


@given(st.floats(0, 10), st.floats(0, 10), st.floats(0.01, 3))
def test_a_bounded_score_is_the_score_at_first_and_never_more_than_its_tail_allows(score, other, tail):
    bounded = float(bounded_score(t(score), tail))
    assert bounded <= min(score, math.pi / 2 * tail) + 1e-12
    assert float(bounded_score(t(1e-4 * tail), tail)) == pytest.approx(1e-4 * tail, rel=1e-6)
    x = t(score).requires_grad_()
    (gradient,) = torch.autograd.grad(bounded_score(x, tail), x)
    slope = float(bounded_slope(t(score), tail))
    assert slope == pytest.approx(float(gradient))
    # concave: its tangent lies above it
    assert float(bounded_score(t(other), tail)) <= bounded + slope * (other - score) + 1e-9


@given(mus, sigmas, st.floats(-5, 5), st.floats(0.01, 1))
def test_the_weight_majorizes_a_bounded_score_too(mu, sigma, other, tail):
    score = energy_score(t(mu), t(sigma))
    weight = float(majorizing_weight(t(mu), t(sigma)) * bounded_slope(score, tail))
    tangent = float(bounded_score(score, tail)) + 0.5 * weight * (other**2 - mu**2)
    assert float(bounded_score(energy_score(t(other), t(sigma)), tail)) <= tangent + 1e-7 * (1 + abs(tangent))
