from typing import Any

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from factors.code_mixture import CodeMixture, mixture_prior
from factors.errors import FactorError
from factors.state import ObjectKeys

KEYS = ObjectKeys.numbered(1)
LENGTH = 3


def mixture(seed: int = 0, count: int = 4, apart: float = 2.0) -> CodeMixture:
    rng = np.random.default_rng(seed)
    weight = rng.uniform(0.1, 1.0, count)
    means = apart * rng.normal(size=(count, LENGTH))
    return CodeMixture(weight / weight.sum(), means, rng.uniform(0.1, 2.0, (count, LENGTH)))


def log_densities(codes: CodeMixture, code: np.ndarray) -> np.ndarray:
    """Logarithm of each Gaussian's weighted density."""
    return np.array(
        [
            np.log(w) + multivariate_normal(mean=m, cov=np.diag(v)).logpdf(code)  # pyright: ignore[reportArgumentType]
            for w, m, v in zip(codes.weight, codes.mean, codes.variance, strict=True)
        ]
    )


def values_of(code: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEYS.code, np.asarray(code, float))
    return values


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_costs_are_negative_log_densities_up_to_one_constant(seed: int) -> None:
    codes = mixture(seed)
    points = np.random.default_rng(seed + 1).normal(size=(5, LENGTH)) * 3
    off = codes.costs(points) + np.array([log_densities(codes, point) for point in points])
    np.testing.assert_allclose(off, off[0, 0], atol=1e-9)
    assert codes.rarity.min() == 0
    for point, best in zip(points, codes.likeliest(points), strict=True):
        assert best == log_densities(codes, point).argmax()


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_the_factor_costs_what_the_likeliest_gaussian_says_and_has_its_gradient(seed: int) -> None:
    codes = mixture(seed)
    code = np.random.default_rng(seed + 2).normal(size=LENGTH) * 3
    factor, values = mixture_prior(KEYS, codes), values_of(code)
    constant = codes.costs(codes.mean[:1]).min() + log_densities(codes, codes.mean[0]).max()
    assert factor.error(values) == pytest.approx(constant - log_densities(codes, code).max(), abs=1e-8)

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor)
    gradient = graph.linearize(values).gradientAtZero().at(KEYS.code)
    gaps = np.sort(codes.costs(code[None])[0])
    if gaps[1] - gaps[0] > 1e-3:  # not where two are equally likely
        step = 1e-6
        slope = [
            (factor.error(values_of(code + step * axis)) - factor.error(values_of(code - step * axis)))
            / (2 * step)
            for axis in np.eye(LENGTH)
        ]
        np.testing.assert_allclose(gradient, slope, rtol=1e-4, atol=1e-5)


def test_the_cost_never_exceeds_that_of_all_gaussians_by_more_than_their_number_allows() -> None:
    codes = mixture(3, apart=0.5)
    for code in np.random.default_rng(4).normal(size=(20, LENGTH)):
        each = log_densities(codes, code)
        assert logsumexp(each) - np.log(len(each)) <= each.max() <= logsumexp(each)


def test_drawn_codes_have_the_moments_and_stay_within_the_bounds() -> None:
    codes = mixture(5)
    drawn = codes.draw(200_000, np.random.default_rng(0))
    mean, covariance = codes.moments()
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=0.02)
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.08)
    near = codes.draw(2_000, np.random.default_rng(1), within=1.5)
    off = np.abs(near[:, None] - codes.mean) / np.sqrt(codes.variance)
    assert (off.max(axis=2).min(axis=1) <= 1.5).all()


def test_one_gaussian_is_an_ordinary_prior() -> None:
    codes = CodeMixture(np.ones(1), np.array([[0.1, 0.2, 0.3]]), np.array([[1.0, 4.0, 0.25]]))
    code = np.array([1.0, -1.0, 0.5])
    noise = gtsam.noiseModel.Diagonal.Variances(codes.variance[0])
    expected = gtsam.PriorFactorVector(KEYS.code, codes.mean[0], noise).error(values_of(code))
    assert mixture_prior(KEYS, codes).error(values_of(code)) == pytest.approx(expected)


def test_optimisers_move_a_code_to_the_gaussian_that_it_is_of() -> None:
    codes = CodeMixture(
        np.array([0.5, 0.5]), np.array([[-2.0, 0, 0], [2.0, 0, 0]]), np.full((2, LENGTH), 0.2)
    )
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(mixture_prior(KEYS, codes))
    for start in (-0.5, 0.5):
        found = gtsam.LevenbergMarquardtOptimizer(graph, values_of(np.array([start, 1.0, 1.0]))).optimize()
        np.testing.assert_allclose(found.atVector(KEYS.code), [np.sign(start) * 2.0, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("weight", "mean", "variance"),
    [
        (np.ones(2) / 2, np.zeros((3, LENGTH)), np.ones((3, LENGTH))),
        (np.ones(1), np.zeros((1, LENGTH)), np.ones((1, 2))),
        (np.array([0.5, 0.4]), np.zeros((2, LENGTH)), np.ones((2, LENGTH))),
        (np.array([1.5, -0.5]), np.zeros((2, LENGTH)), np.ones((2, LENGTH))),
        (np.ones(1), np.full((1, LENGTH), np.nan), np.ones((1, LENGTH))),
        (np.ones(1), np.zeros((1, LENGTH)), np.zeros((1, LENGTH))),
        (np.ones(0), np.zeros((0, LENGTH)), np.ones((0, LENGTH))),
    ],
)
def test_what_is_no_mixture_is_refused(weight: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> None:
    with pytest.raises(FactorError, match="mixture"):
        CodeMixture(weight, mean, variance)


def test_a_code_of_another_length_is_refused_by_name() -> None:
    with pytest.raises(FactorError, match="z1 holds a code of length 2, its prior is of 3"):
        mixture_prior(KEYS, mixture()).error(values_of(np.zeros(2)))


def test_a_prior_of_something_else_is_refused() -> None:
    codes: Any = np.zeros(3)
    keys: Any = "o1"
    with pytest.raises(FactorError, match="codes"):
        mixture_prior(KEYS, codes)
    with pytest.raises(FactorError, match="keys"):
        mixture_prior(keys, mixture())
