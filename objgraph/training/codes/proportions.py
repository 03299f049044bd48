"""How far the codes of known shapes say what their proportions are."""

import numpy as np
from jaxtyping import Float

from factors.proportions import Proportions

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
    seed: int = 0,
) -> Proportions | None:
    """Of shapes with these codes and boxes of diagonal 1, in a prior whose shapes fill `box` and whose codes are of `covariance`.

    A ridge regression; what is left over is what it leaves of shapes that it was not fitted to. None where they are fewer than
    `FEWEST`.
    """
    if len(codes) < FEWEST:
        return None
    middle, u = codes.mean(axis=0), np.log(extents / box)
    variance, axes = np.linalg.eigh(covariance)
    whitening = axes / np.sqrt(np.maximum(variance, 1e-9))
    x = (codes - middle) @ whitening
    fold = np.random.default_rng(seed).permutation(len(codes)) % _FOLDS
    left = {penalty: _left_over(x, u, fold, penalty) for penalty in _PENALTIES}
    best = min(left, key=lambda penalty: float(np.square(left[penalty]).sum()))
    slope = (whitening @ _ridge(x, u - u.mean(axis=0), best)).T
    rest = left[best].T @ left[best] / len(codes)
    return Proportions(u.mean(axis=0) - slope @ middle, slope, rest + _LEAST**2 * np.eye(3))


def _left_over(
    x: Float[np.ndarray, "n l"], u: Float[np.ndarray, "n 3"], fold: np.ndarray, penalty: float
) -> Float[np.ndarray, "n 3"]:
    """Of each shape, by a fit to the other folds'."""
    left = np.zeros_like(u)
    for k in range(_FOLDS):
        own = fold == k
        mean = u[~own].mean(axis=0)
        left[own] = u[own] - mean - x[own] @ _ridge(x[~own], u[~own] - mean, penalty)
    return left


def _ridge(
    x: Float[np.ndarray, "n l"], u: Float[np.ndarray, "n 3"], penalty: float
) -> Float[np.ndarray, "l 3"]:
    return np.linalg.solve(x.T @ x + penalty * np.eye(x.shape[1]), x.T @ u)
