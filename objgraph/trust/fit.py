"""From objects with ground truth to a calibration, and what it gives on objects that were held out.

Verdicts are logistic regressions. Sets are calibrated by split conformal prediction (Vovk et al., "Algorithmic Learning in a
Random World", 2005) of a normalised score (Lei et al., JASA 2018): how much an object's covariance would have had to be widened,
over what its evidence lets expect. Folds are of shapes, so no object is judged by a fit that saw its shape.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from objgraph.covariance.box_modes import EVERY_AXIS, HEADING_AXIS, factor_needed
from objgraph.covariance.quantile import squared_limit
from objgraph.covariance.sides import SideMisfit
from objgraph.errors import CovarianceError
from objgraph.trust.calibration import LEVELS, QUANTITIES, Calibration, Line, Widening, widened
from objgraph.trust.evidence import NAMES, Evidence
from objgraph.trust.verdict import SURE

FOLDS = 10
RIGHT_HEADING = 0.35
"""Radians; the paper's 20 degrees."""
_STUDENT = 5.0
"""Degrees of freedom."""
_USUAL = (2.0, 0.015, 0.1)
"""Where the search for the sides' misfit begins."""
_LEAST_SIDES = 10
LEAST = 40
"""Objects below which nothing can be said of 95 %."""
_RIDGE = 2.0
"""Weight of the squared coefficients, as of so many objects at one standard deviation."""
_TINY = 1e-9


@dataclass(frozen=True)
class Judged:
    """An estimated object and what is true of it."""

    category: str
    shape: str
    """Objects of one are never on both sides of a fold."""
    group: str
    """What held-out figures are broken down by, beside the category: data set, difficulty, views."""
    evidence: Evidence
    pose_right: bool
    shape_right: bool
    modes: Sequence[tuple[float, Float[np.ndarray, "9"]]]
    """Of each heading its probability, and the error of its box in the axes of the estimate's; that one first."""
    marginals: Float[np.ndarray, "9 9"]
    """The box's covariance as the graph gives it."""
    extents: Float[np.ndarray, "3"]
    seen_sides: Float[np.ndarray, "3 2"]
    surface: Mapping[str, float]
    """By level: the least factor on the variances of the surface at which that share of its points lies within."""


def fit(
    objects: Sequence[Judged], priors: Mapping[str, str], made: Mapping[str, Any], seed: int = 0
) -> Calibration:
    """A calibration from all objects; `made` gets the held-out figures.

    Raises:
        CovarianceError: there are fewer than `LEAST`, or all poses are right or wrong.
    """
    if len(objects) < LEAST:
        raise CovarianceError(
            f"{len(objects)} objects are too few for a calibration: at least {LEAST} are due"
        )
    right = [each.pose_right for each in objects]
    if all(right) or not any(right):
        raise CovarianceError(
            "of all objects the pose is right, or of all wrong: add scans of another difficulty"
        )
    table = _Table(objects)
    whole = _fitted(table, np.ones(len(objects), bool))
    counts = {name: sum(each.category == name for each in objects) for name in table.categories}
    return Calibration(
        **_parts(table, whole),
        priors=dict(priors),
        objects=counts,
        made={**made, "held_out": held_out(objects, seed)},
    )


def held_out(objects: Sequence[Judged], seed: int = 0) -> list[dict[str, Any]]:
    """Figures of every category and group and of all, each object judged by a fit to the other folds' shapes."""
    table = _Table(objects)
    shapes = sorted({each.shape for each in objects})
    folds = dict(zip(shapes, np.random.default_rng(seed).permutation(len(shapes)) % FOLDS, strict=True))
    fold = np.array([folds[each.shape] for each in objects])
    pose, held = np.zeros(len(objects)), {q: np.zeros((len(objects), len(LEVELS))) for q in QUANTITIES}
    size, as_they_come = np.zeros((2, len(objects), len(LEVELS)))
    for k in np.unique(fold):
        fitted, out = _fitted(table, fold != k), fold == k
        pose[out] = _logistic(table.X[out] @ fitted.pose)
        for name in QUANTITIES:
            factor = np.exp(table.X[out] @ fitted.usual[name])[:, None] * fitted.factors[name]
            held[name][out] = fitted.needed[name][out] <= factor
            if name == "box":
                size[out] = np.sqrt(factor) * _size(fitted.matrices[out])[:, None]
        as_they_come[out] = fitted.needed["box"][out] <= 1
    groups = {"all": np.ones(len(objects), bool)}
    groups |= {name: table.category == name for name in table.categories}
    groups |= {name: table.group == name for name in sorted(set(table.group))}
    return [
        {"of": name, **_figures(table, chosen, pose, held, as_they_come, size)}
        for name, chosen in groups.items()
    ]


class _Table:
    """Objects as arrays."""

    def __init__(self, objects: Sequence[Judged]) -> None:
        given = np.array([[each.evidence.to_json()[name] for name in NAMES] for each in objects])
        self.mean, self.spread = given.mean(axis=0), np.maximum(given.std(axis=0), _TINY)
        self.category = np.array([each.category for each in objects])
        self.group = np.array([each.group for each in objects])
        self.categories = sorted(set(self.category))
        is_of = (self.category[:, None] == np.array(self.categories)).astype(float)
        self.X = np.concatenate(
            [np.ones((len(objects), 1)), is_of, (given - self.mean) / self.spread], axis=1
        )
        self.pose = np.array([each.pose_right for each in objects], float)
        self.shape = np.array([each.shape_right for each in objects], float)
        self.modes = [each.modes for each in objects]
        self.errors = np.array([each.modes[0][1] for each in objects])
        self.marginals = np.array([each.marginals for each in objects])
        self.extents = np.array([each.extents for each in objects])
        self.seen_sides = np.array([each.seen_sides for each in objects])
        self.surface = np.array([[each.surface[level] for level in LEVELS] for each in objects])
        self.raw = self.needed(self.marginals)

    def with_sides(self, sides: Mapping[str, SideMisfit]) -> Float[np.ndarray, "n 9 9"]:
        """The boxes' covariances with the sides' errors."""
        matrices = np.empty_like(self.marginals)
        for name, each in sides.items():
            of = self.category == name
            matrices[of] = widened(each, self.marginals[of], self.extents[of], self.seen_sides[of])
        return matrices

    def needed(self, matrices: Float[np.ndarray, "n 9 9"]) -> dict[str, Float[np.ndarray, "n l"]]:
        """Of each quantity, by level: the least factor at which the set holds the truth."""
        found = {"surface": self.surface}
        for name, axes in (("box", EVERY_AXIS), ("heading", HEADING_AXIS)):
            radii = [squared_limit(float(level) / 100, len(axes)) for level in LEVELS]
            found[name] = np.array(
                [
                    [factor_needed(modes, matrix, radius, axes) for radius in radii]
                    for modes, matrix in zip(self.modes, matrices, strict=True)
                ]
            )
        return found


@dataclass(frozen=True)
class _Fitted:
    sides: Mapping[str, SideMisfit]
    matrices: Float[np.ndarray, "n 9 9"]
    """Of all objects, with these sides' errors."""
    needed: Mapping[str, Float[np.ndarray, "n l"]]
    pose: Float[np.ndarray, "f"]
    shape: Float[np.ndarray, "f"]
    usual: Mapping[str, Float[np.ndarray, "f"]]
    factors: Mapping[str, Float[np.ndarray, "l"]]


def _fitted(table: _Table, chosen: np.ndarray) -> _Fitted:
    X = table.X[chosen]
    usual, factors = {}, {}
    sides = {name: _sides(table, chosen & (table.category == name)) for name in table.categories}
    matrices = table.with_sides(sides)
    needed = table.needed(matrices)
    for name in QUANTITIES:
        log_needed = np.log(np.maximum(needed[name][chosen], _TINY))
        usual[name] = _least_squares(X, np.where(np.isfinite(log_needed), log_needed, 20.0)[:, 1])
        rest = log_needed - (X @ usual[name])[:, None]
        factors[name] = np.exp([_conformal(rest[:, i], float(level) / 100) for i, level in enumerate(LEVELS)])
    pose, shape = (_regression(X, right[chosen]) for right in (table.pose, table.shape))
    return _Fitted(sides, matrices, needed, pose, shape, usual, factors)


def _sides(table: _Table, chosen: np.ndarray) -> SideMisfit:
    """The likeliest, of boxes whose heading is right, with Student's t in place of the normal distribution: a mask with a
    neighbour in it must not speak for all."""
    chosen = chosen & (np.abs(table.errors[:, 1]) < RIGHT_HEADING)
    if chosen.sum() < _LEAST_SIDES:
        raise CovarianceError(
            f"{chosen.sum()} objects of a category with the right heading are too few: at least {_LEAST_SIDES} are due"
        )
    errors, marginals = table.errors[chosen], table.marginals[chosen]
    extents, seen = table.extents[chosen], table.seen_sides[chosen]

    def loss(log_values: np.ndarray) -> float:
        matrices = widened(SideMisfit(*np.exp(log_values)), marginals, extents, seen)
        squared = np.einsum("ni,ni->n", errors, np.linalg.solve(matrices, errors[..., None])[..., 0])
        spread = 0.5 * np.linalg.slogdet(matrices)[1]
        return float(np.mean(spread + 0.5 * (_STUDENT + 9) * np.log1p(squared / _STUDENT)))

    bounds = [(np.log(low), np.log(high)) for low, high in ((0.1, 100.0), (1e-3, 0.2), (1e-3, 1.0))]
    found = minimize(loss, np.log(_USUAL), method="Nelder-Mead", bounds=bounds, options={"maxiter": 400})
    return SideMisfit(*(float(value) for value in np.exp(found.x)))


def _conformal(scores: Float[np.ndarray, "n"], level: float) -> float:
    """The (n + 1) level-th smallest: what a further one is below with that probability at least."""
    rank = min(int(np.ceil((len(scores) + 1) * level)), len(scores))
    return float(np.sort(scores)[rank - 1])


def _least_squares(X: Float[np.ndarray, "n f"], y: Float[np.ndarray, "n"]) -> Float[np.ndarray, "f"]:
    return np.linalg.solve(X.T @ X + _ridge(X), X.T @ y)


def _regression(X: Float[np.ndarray, "n f"], right: Float[np.ndarray, "n"]) -> Float[np.ndarray, "f"]:
    """Coefficients of the log-odds."""
    ridge = _ridge(X)

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        odds = X @ w
        value = np.logaddexp(0, odds).sum() - right @ odds + 0.5 * w @ ridge @ w
        return float(value), X.T @ (_logistic(odds) - right) + ridge @ w

    return minimize(loss, np.zeros(X.shape[1]), jac=True, method="BFGS").x


def _ridge(X: Float[np.ndarray, "n f"]) -> Float[np.ndarray, "f f"]:
    return np.diag([_TINY, *[_RIDGE] * (X.shape[1] - 1)])


def _logistic(odds: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-odds))


def _parts(table: _Table, fitted: _Fitted) -> dict[str, Any]:
    n = len(table.categories)

    def line(w: np.ndarray) -> Line:
        values = [float(each) for each in w]
        offsets = dict(zip(table.categories, values[1 : 1 + n], strict=True))
        return Line(values[0], offsets, dict(zip(NAMES, values[1 + n :], strict=True)))

    widening = {
        name: Widening(
            line(fitted.usual[name]), dict(zip(LEVELS, map(float, fitted.factors[name]), strict=True))
        )
        for name in QUANTITIES
    }
    return {
        "mean": dict(zip(NAMES, map(float, table.mean), strict=True)),
        "spread": dict(zip(NAMES, map(float, table.spread), strict=True)),
        "pose": line(fitted.pose),
        "shape": line(fitted.shape),
        "sides": fitted.sides,
        "widening": widening,
    }


def _figures(
    table: _Table,
    chosen: np.ndarray,
    pose: np.ndarray,
    held: Mapping[str, np.ndarray],
    as_they_come: np.ndarray,
    size: np.ndarray,
) -> dict[str, Any]:
    right, said = table.pose[chosen], pose[chosen]
    sure = said >= SURE
    figures: dict[str, Any] = {
        "objects": int(chosen.sum()),
        "right": float(right.mean()),
        "brier": float(np.mean((said - right) ** 2)),
        "brier_base": float(right.mean() * (1 - right.mean())),
        "sure": int(sure.sum()),
        "sure_right": float(right[sure].mean()) if sure.any() else None,
        "set_size_95": float(np.median(size[chosen, -1])),
        "set_size_95_marginals": float(np.median(_size(table.marginals)[chosen])),
    }
    for i, level in enumerate(LEVELS):
        figures[f"box_{level}_marginals"] = float((table.raw["box"][chosen, i] <= 1).mean())
        figures[f"box_{level}_sides"] = float(as_they_come[chosen, i].mean())
        figures |= {f"{name}_{level}": float(held[name][chosen, i].mean()) for name in QUANTITIES}
    return figures


def _size(matrices: Float[np.ndarray, "n 9 9"]) -> Float[np.ndarray, "n"]:
    """Geometric mean of the standard deviations along the axes: radians, metres and shares alike."""
    return np.exp(np.linalg.slogdet(matrices)[1] / 18)
