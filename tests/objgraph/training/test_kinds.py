import numpy as np
import torch
from torch.distributions import Normal, kl_divergence

from objgraph.training.decoder.kinds import Kinds

LENGTH = 4


def gaussians(seed: int, count: int = 60) -> tuple[torch.Tensor, torch.Tensor]:
    """Means about three places, and logarithms of variances."""
    generator = torch.Generator().manual_seed(seed)
    places = torch.tensor([[3.0, 0, 0, 0], [-3.0, 0, 0, 0], [0, 4.0, 0, 0]]).double()
    mean = places[torch.arange(count) % 3] + 0.2 * torch.randn(count, LENGTH, generator=generator).double()
    return mean, -3 + 0.5 * torch.randn(count, LENGTH, generator=generator).double()


def test_at_first_the_divergence_is_that_from_a_standard_normal() -> None:
    mean, log_variance = gaussians(0)
    found = Normal(mean, (0.5 * log_variance).exp())
    there = Normal(torch.zeros(LENGTH).double(), torch.ones(LENGTH).double())
    kinds = Kinds(3, mean)
    torch.testing.assert_close(kinds.divergence(mean, log_variance), kl_divergence(found, there).sum(dim=1))
    alone = Kinds(1, mean)
    alone.fit(mean, log_variance)
    torch.testing.assert_close(alone.divergence(mean, log_variance), kinds.divergence(mean, log_variance))


def test_a_fitted_mixture_bounds_the_divergence_that_draws_measure() -> None:
    mean, log_variance = gaussians(1)
    kinds = Kinds(3, mean)
    for _ in range(5):
        kinds.fit(mean, log_variance)
    bound = kinds.divergence(mean, log_variance)
    generator = torch.Generator().manual_seed(0)
    found = Normal(mean, (0.5 * log_variance).exp())
    draws = mean + (0.5 * log_variance).exp() * torch.randn(20_000, *mean.shape, generator=generator).double()
    parts = Normal(kinds.mean, kinds.variance.sqrt())
    density = torch.stack(
        [
            w.log() + Normal(m, s).log_prob(draws).sum(-1)
            for w, m, s in zip(kinds.weight, parts.mean, parts.stddev, strict=True)
        ]
    ).logsumexp(dim=0)
    measured = (found.log_prob(draws).sum(-1) - density).mean(dim=0)
    assert (bound >= measured - 0.05).all()
    # kinds that are apart: next to no code is of two, and the bound is tight
    torch.testing.assert_close(bound, measured, atol=0.05, rtol=0)


def test_the_kinds_that_there_are_are_found_whatever_the_seed() -> None:
    for seed in range(5):
        mean, log_variance = gaussians(seed, 600)
        kinds = Kinds(3, mean, seed)
        for _ in range(20):
            kinds.fit(mean, log_variance)
        order = kinds.mean[:-1, 1].argsort()
        apart = kinds.mean[order]
        torch.testing.assert_close(apart[2], torch.tensor([0, 4.0, 0, 0]).double(), atol=0.1, rtol=0)
        torch.testing.assert_close(apart[:2, 0].abs(), torch.tensor([3.0, 3.0]).double(), atol=0.1, rtol=0)
        torch.testing.assert_close(kinds.weight[:-1], torch.full((3,), 0.98 / 3).double(), atol=0.01, rtol=0)
        before = Kinds(3, mean).divergence(mean, log_variance).mean()
        assert kinds.divergence(mean, log_variance).mean() < before - 3


def test_state_goes_back_and_the_mixture_is_the_same() -> None:
    mean, log_variance = gaussians(2)
    kinds, other = Kinds(3, mean), Kinds(3, mean)
    kinds.fit(mean, log_variance)
    other.restore(kinds.state())
    assert torch.equal(other.divergence(mean, log_variance), kinds.divergence(mean, log_variance))
    mixture = other.mixture()
    assert mixture is not None
    assert mixture.weight.sum() == 1.0
    np.testing.assert_array_equal(mixture.mean, kinds.mean.numpy())
    np.testing.assert_array_equal(other.moments(mean, log_variance)[1], mixture.moments()[1])


def test_codes_of_one_gaussian_have_the_moments_of_draws_from_all_of_them() -> None:
    mean, log_variance = gaussians(5, 600)
    alone = Kinds(1, mean)
    alone.fit(mean, log_variance)
    assert alone.mixture() is None
    middle, covariance = alone.moments(mean, log_variance)
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(500, *mean.shape, generator=generator).double()
    draws = (mean + (0.5 * log_variance).exp() * noise).reshape(-1, LENGTH).numpy()
    np.testing.assert_allclose(middle, draws.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.02)


def test_a_code_of_no_kind_costs_little_more_than_one_gaussian_of_all_makes_it() -> None:
    mean, log_variance = gaussians(3, 600)
    kinds = Kinds(3, mean)
    for _ in range(20):
        kinds.fit(mean, log_variance)
    stray, narrow = torch.full((1, LENGTH), 2.0).double(), torch.full((1, LENGTH), -3.0).double()
    spread = (log_variance.exp().mean(dim=0) + mean.var(dim=0)).sqrt()
    alone = kl_divergence(Normal(stray, (0.5 * narrow).exp()), Normal(mean.mean(dim=0), spread)).sum(dim=1)
    assert kinds.divergence(stray, narrow) <= alone + np.log(1 / 0.02) + 1e-9
    of_kinds = Kinds(3, mean)
    of_kinds.restore({name: tensor[:-1] for name, tensor in kinds.state().items()})
    assert of_kinds.divergence(stray, narrow) > alone + 20


def test_a_kind_of_one_shape_is_spread_as_others_are_not_as_all_codes() -> None:
    mean, log_variance = gaussians(4, 600)
    mean[0] = torch.tensor([0, 0, 9.0, 0])
    kinds = Kinds(4, mean)
    for _ in range(20):
        kinds.fit(mean, log_variance)
    found = kinds.variance[kinds.mean[:-1, 2].argmax()]
    usual = kinds.variance[:-1].median(dim=0).values
    assert (found < 2 * usual).all()
    assert (found[:2] < 0.1 * mean.var(dim=0)[:2]).all()
