"""What a code says of an object's proportions."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.errors import FactorError
from factors.proportions import Proportions, proportions_prior
from factors.state import ObjectKeys

KEYS = ObjectKeys.numbered(2)
SIZE, SIZE_SIGMA = 0.3, 0.4


def drawn(rng: np.random.Generator, length: int) -> Proportions:
    root = rng.normal(size=(3, 3))
    return Proportions(
        rng.normal(size=3), rng.normal(size=(3, length)), 0.01 * (root @ root.T) + 1e-4 * np.eye(3)
    )


def at(log_scale: np.ndarray, code: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEYS.log_scale, log_scale)
    values.insert(KEYS.code, code)
    return values


@given(st.integers(0, 10**6), st.integers(1, 8))
def test_it_is_half_the_squared_distance_from_what_the_code_says(seed, length):
    rng = np.random.default_rng(seed)
    known, code, log_scale = drawn(rng, length), rng.normal(size=length), rng.normal(size=3)
    factor = proportions_prior(KEYS, known, SIZE, SIZE_SIGMA)
    off = log_scale - SIZE - known.of(code)
    covariance = known.covariance + SIZE_SIGMA**2
    assert factor.error(at(log_scale, code)) == pytest.approx(0.5 * off @ np.linalg.solve(covariance, off))
    assert factor.error(at(SIZE + known.of(code), code)) == pytest.approx(0.0, abs=1e-9)


@given(st.integers(0, 10**6))
def test_it_is_the_same_wherever_it_is_linearised(seed):
    rng = np.random.default_rng(seed)
    factor = proportions_prior(KEYS, drawn(rng, 4), SIZE, SIZE_SIGMA)
    here, there = (at(rng.normal(size=3), rng.normal(size=4)) for _ in range(2))
    linear, delta = factor.linearize(here), here.localCoordinates(there)
    assert linear.error(delta) == pytest.approx(factor.error(there), rel=1e-6, abs=1e-9)
    np.testing.assert_allclose(
        linear.information(), factor.linearize(there).information(), rtol=1e-9, atol=1e-9
    )


def test_with_a_prior_of_codes_scales_vary_as_shapes_do():
    """The marginal of the log-scale is that of draws: of a code, of proportions given it, and of a size."""
    rng = np.random.default_rng(0)
    known = drawn(rng, 4)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(proportions_prior(KEYS, known, SIZE, SIZE_SIGMA))
    graph.push_back(gtsam.PriorFactorVector(KEYS.code, np.zeros(4), gtsam.noiseModel.Isotropic.Sigma(4, 0.5)))
    marginal = gtsam.Marginals(graph, at(np.zeros(3), np.zeros(4))).marginalCovariance(KEYS.log_scale)
    codes = rng.normal(0, 0.5, (400_000, 4))
    draws = known.of(codes) + rng.multivariate_normal(np.zeros(3), known.covariance, len(codes))
    draws += rng.normal(0, SIZE_SIGMA, (len(codes), 1))
    np.testing.assert_allclose(marginal, np.cov(draws.T), rtol=0.02, atol=0.005)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"mean": np.zeros(2)}, "the proportions' mean has shape"),
        ({"slope": np.zeros((2, 4))}, "the proportions' slope has shape"),
        ({"slope": np.full((3, 4), np.nan)}, "not finite"),
        ({"covariance": -np.eye(3)}, "not positive definite"),
    ],
)
def test_what_are_no_proportions_is_named(change, complaint):
    given = {"mean": np.zeros(3), "slope": np.zeros((3, 4)), "covariance": np.eye(3)}
    with pytest.raises(FactorError, match=complaint):
        Proportions(**{**given, **change})


def test_a_size_of_no_deviation_is_refused():
    with pytest.raises(FactorError, match="size_sigma"):
        proportions_prior(KEYS, drawn(np.random.default_rng(0), 4), SIZE, 0.0)
