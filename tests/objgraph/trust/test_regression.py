"""Lines in the evidence: what is asked of them, and nothing less likely."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.trust.regression import least_squares


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evidence of 60 objects with an intercept, what it explains, and weights to be held toward."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([np.ones(60), rng.normal(size=(60, 4))])
    return X, X @ rng.normal(size=5) + 0.3 * rng.normal(size=60), rng.normal(size=4)


def loss(w: np.ndarray, X: np.ndarray, y: np.ndarray, toward: np.ndarray) -> float:
    return float(np.square(y - X @ w).sum() + 30.0 * np.square(w[1:] - toward).sum())


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_without_bounds_the_normal_equations_hold(seed):
    X, y, toward = drawn(seed)
    w = least_squares(X, y, toward=toward)
    pull = np.concatenate([[0.0], 30.0 * (w[1:] - toward)])
    np.testing.assert_allclose(X.T @ (X @ w - y) + pull, 0.0, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-1, 1))
def test_a_weight_stays_below_its_bound_and_the_rest_is_the_best_there(seed, most):
    X, y, toward = drawn(seed)
    bounds = np.array([np.inf, most, np.inf, np.inf])
    w = least_squares(X, y, toward=toward, most=bounds)
    assert w[2] <= most + 1e-9
    rng = np.random.default_rng(seed + 1)
    for _ in range(50):
        other = w + 0.05 * rng.normal(size=5)
        other[2] = min(other[2], most)
        assert loss(w, X, y, toward) <= loss(other, X, y, toward) + 1e-6
