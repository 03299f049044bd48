"""How far the codes of known shapes say what their proportions are."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from factors.proportions import Proportions
from objgraph.training.size import source_weights

_PENALTIES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Of a ridge regression on whitened codes; that which tells left-out shapes best is taken."""
_FOLDS = 8
_LEAST = 0.05
"""Added to what is left over, a deviation of the logarithm: objects that are used have proportions of their own."""
FEWEST = 40
"""Shapes by which it is fitted."""


def fit_proportions(
    codes: Float[np.ndarray, "n l"],
    extents: Float[np.ndarray, "n 3"],
    box: Float[np.ndarray, "3"],
    covariance: Float[np.ndarray, "l l"],
    sources: Sequence[str] | None = None,
    seed: int = 0,
) -> Proportions | None:
    """Of shapes with these codes and boxes of diagonal 1, in a prior whose shapes fill `box` and whose codes are of `covariance`.

    A ridge regression; what is left over is what it leaves of shapes that it was not fitted to. Of the `sources` that the
    shapes are from (left out: all from one) none counts as more than `size.source_weights` says: a generator's proportions
    are its author's. None where shapes are fewer than `FEWEST`.
    """
    if len(codes) < FEWEST:
        return None
    weight = source_weights(["" for _ in codes] if sources is None else sources)
    weight = weight / weight.mean()
    u = np.log(extents / box)
    middle, mean = (np.average(of, axis=0, weights=weight) for of in (codes, u))
    variance, axes = np.linalg.eigh(covariance)
    whitening = axes / np.sqrt(np.maximum(variance, 1e-9))
    x = (codes - middle) @ whitening
    fold = np.random.default_rng(seed).permutation(len(codes)) % _FOLDS
    left = {penalty: _left_over(x, u, weight, fold, penalty) for penalty in _PENALTIES}
    rest = {penalty: off.T @ (weight[:, None] * off) / len(codes) for penalty, off in left.items()}
    best = min(rest, key=lambda penalty: float(np.trace(rest[penalty])))
    slope = (whitening @ _ridge(x, u - mean, weight, best)).T
    return Proportions(mean - slope @ middle, slope, rest[best] + _LEAST**2 * np.eye(3))


def _left_over(
    x: Float[np.ndarray, "n l"], u: Float[np.ndarray, "n 3"], weight: Float[np.ndarray, "n"], fold: np.ndarray,
    penalty: float,
) -> Float[np.ndarray, "n 3"]:  # fmt: skip
    """Of each shape, by a fit to the other folds'."""
    left = np.zeros_like(u)
    for k in range(_FOLDS):
        own = fold == k
        mean = np.average(u[~own], axis=0, weights=weight[~own])
        left[own] = u[own] - mean - x[own] @ _ridge(x[~own], u[~own] - mean, weight[~own], penalty)
    return left


def _ridge(
    x: Float[np.ndarray, "n l"], u: Float[np.ndarray, "n 3"], weight: Float[np.ndarray, "n"], penalty: float
) -> Float[np.ndarray, "l 3"]:
    weighted = weight[:, None] * x
    return np.linalg.solve(weighted.T @ x + penalty * np.eye(x.shape[1]), weighted.T @ u)
