"""Lines in the evidence, held to other lines, and the quantile that conformal prediction takes."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear, minimize

_RIDGE = 30.0
"""Weight of the squared coefficients, as of so many objects at one standard deviation."""
_TINY = 1e-9


def stacked(
    parts: Sequence[tuple[Float[np.ndarray, "n f"], Float[np.ndarray, "n"]]],
) -> tuple[Float[np.ndarray, "m g"], Float[np.ndarray, "m"]]:
    """Of some categories together: an intercept each, and the same weights."""
    which = np.repeat(np.arange(len(parts)), [len(y) for _, y in parts])
    weights = np.concatenate([X[:, 1:] for X, _ in parts])
    return np.concatenate([np.eye(len(parts))[which], weights], axis=1), np.concatenate([y for _, y in parts])


def least_squares(
    X: Float[np.ndarray, "n f"],
    y: Float[np.ndarray, "n"],
    intercepts: int = 1,
    toward: Float[np.ndarray, "w"] | None = None,
    most: Float[np.ndarray, "w"] | None = None,
) -> Float[np.ndarray, "f"]:
    """Coefficients, of which the weights, behind the intercepts, are held toward others, or to none; `most` bounds them."""
    ridge, centre = _toward(X.shape[1], intercepts, toward)
    root, upper = np.sqrt(ridge), np.full(X.shape[1], np.inf)
    if most is not None:
        upper[intercepts:] = most
    rows, goal = np.concatenate([X, root]), np.concatenate([y, root @ centre])
    return lsq_linear(rows, goal, (-np.inf, upper)).x


def log_odds(
    X: Float[np.ndarray, "n f"],
    right: Float[np.ndarray, "n"],
    intercepts: int = 1,
    toward: Float[np.ndarray, "w"] | None = None,
) -> Float[np.ndarray, "f"]:
    """The same of the log-odds. Two more objects of each intercept, with the usual evidence, are one right and one wrong (Laplace's
    rule of succession): where all are right the next one need not be."""
    ridge, centre = _toward(X.shape[1], intercepts, toward)
    usual = np.eye(intercepts, X.shape[1])
    X = np.concatenate([X, usual, usual])
    right = np.concatenate([right, np.ones(intercepts), np.zeros(intercepts)])

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        odds, off = X @ w, w - centre
        value = np.logaddexp(0, odds).sum() - right @ odds + 0.5 * off @ ridge @ off
        return float(value), X.T @ (logistic(odds) - right) + ridge @ off

    return minimize(loss, centre, jac=True, method="BFGS").x


def _toward(
    length: int, intercepts: int, toward: Float[np.ndarray, "w"] | None
) -> tuple[Float[np.ndarray, "f f"], Float[np.ndarray, "f"]]:
    """Weights of the squared coefficients, and what they are held to."""
    weights = np.zeros(length - intercepts) if toward is None else toward
    ridge = np.diag([*[_TINY] * intercepts, *[_RIDGE] * len(weights)])
    return ridge, np.concatenate([np.zeros(intercepts), weights])


def logistic(odds: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-odds))


def conformal(scores: Float[np.ndarray, "n"], level: float) -> float:
    """The (n + 1) level-th smallest: what a further one is below with that probability at least."""
    rank = min(int(np.ceil((len(scores) + 1) * level)), len(scores))
    return float(np.sort(scores)[rank - 1])
