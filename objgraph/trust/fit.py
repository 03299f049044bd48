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
from objgraph.trust.calibration import LEVELS, QUANTITIES, Calibration, CategoryCalibration, Line, Widening
from objgraph.trust.evidence import NAMES, Evidence
from objgraph.trust.verdict import SURE

FOLDS = 10
RIGHT_HEADING = 0.35
"""Radians; the paper's 20 degrees."""
_STUDENT = 5.0
"""Degrees of freedom."""
_USUAL = (2.0, 0.015, 0.1)
"""Where the search for the sides' misfit begins."""
_POSSIBLE = ((0.1, 100.0), (1e-3, 0.2), (1e-3, 1.0))
_NEAR_THE_TAIL = 1
"""Which of the levels the evidence has to explain."""
_NARROWEST_AND_WIDEST = (1e-3, 1e9)
"""Factors beyond which it does not matter: the heading of what is round has no error at all."""
LEAST = 40
"""Objects of a category below which nothing can be said of 95 %."""
LEAST_RIGHT = 10
"""Of them with the right heading."""
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
    """A calibration of every category that has enough objects; `made` gets the held-out figures, and how many objects other
    categories have.

    Args:
        priors: digest of the weights by category.
        seed: of the folds.

    Raises:
        CovarianceError: no category has `LEAST` objects, of which `LEAST_RIGHT` have the right heading.
    """
    of_category: dict[str, list[Judged]] = {}
    for each in objects:
        of_category.setdefault(each.category, []).append(each)
    few = {name: len(some) for name, some in of_category.items() if not _is_enough(some)}
    enough = {name: some for name, some in of_category.items() if name not in few}
    if not enough:
        raise CovarianceError(
            f"no category has enough objects ({', '.join(f'{n} {name}' for name, n in few.items()) or 'none'}): at least {LEAST} are "
            f"due, {LEAST_RIGHT} with the right heading"
        )
    categories = {name: _category(some, priors[name]) for name, some in enough.items()}
    kept = [each for some in enough.values() for each in some]
    return Calibration(categories, {**made, "too_few": few, "held_out": held_out(kept, seed)})


def held_out(objects: Sequence[Judged], seed: int = 0) -> list[dict[str, Any]]:
    """Figures of all, of every category and of every group, each object judged by a fit to the other folds' shapes."""
    judgements = []
    for name in sorted({each.category for each in objects}):
        judgements += _judgements([each for each in objects if each.category == name], seed)
    groups = {"all": judgements}
    for each in judgements:
        groups.setdefault(each.category, []).append(each)
    for each in sorted(judgements, key=lambda each: each.group):
        groups.setdefault(each.group, []).append(each)
    return [{"of": name, **_figures(some)} for name, some in groups.items()]


@dataclass(frozen=True)
class _Judgement:
    """Of an object that the fit did not see."""

    category: str
    group: str
    right: bool
    said: float
    """Probability that the pose is right."""
    held: Mapping[str, Float[np.ndarray, "l"]]
    """Whether sets hold, by level."""
    size: float
    size_marginals: float


def _judgements(objects: Sequence[Judged], seed: int) -> list[_Judgement]:
    table, shapes = _Table(objects), sorted({each.shape for each in objects})
    folds = dict(zip(shapes, np.random.default_rng(seed).permutation(len(shapes)) % FOLDS, strict=True))
    fold = np.array([folds[each.shape] for each in objects])
    marginals, found = table.needed(table.marginals)["box"] <= 1, []
    for k in np.unique(fold):
        fitted = _fitted(table, fold != k)
        for i in np.flatnonzero(fold == k).tolist():
            factor = {
                name: np.exp(table.X[i] @ fitted.usual[name]) * fitted.factors[name] for name in QUANTITIES
            }
            held = {name: fitted.needed[name][i] <= factor[name] for name in QUANTITIES}
            held |= {"box_marginals": marginals[i], "box_sides": fitted.needed["box"][i] <= 1}
            found.append(
                _Judgement(
                    objects[i].category, objects[i].group, objects[i].pose_right, float(_logistic(table.X[i] @ fitted.pose)),
                    held, float(np.sqrt(factor["box"][-1])) * _size(fitted.matrices[i]), _size(table.marginals[i]),
                )
            )  # fmt: skip
    return found


def _is_enough(objects: Sequence[Judged]) -> bool:
    return len(objects) >= LEAST and sum(_has_right_heading(each) for each in objects) >= LEAST_RIGHT


def _has_right_heading(each: Judged) -> bool:
    return bool(abs(each.modes[0][1][1]) < RIGHT_HEADING)


class _Table:
    """Objects of a category as arrays."""

    def __init__(self, objects: Sequence[Judged]) -> None:
        given = np.array([[each.evidence.to_json()[name] for name in NAMES] for each in objects])
        self.mean, self.spread = given.mean(axis=0), np.maximum(given.std(axis=0), _TINY)
        self.X = np.concatenate([np.ones((len(objects), 1)), (given - self.mean) / self.spread], axis=1)
        self.pose = np.array([each.pose_right for each in objects], float)
        self.shape = np.array([each.shape_right for each in objects], float)
        self.modes = [each.modes for each in objects]
        self.errors = np.array([each.modes[0][1] for each in objects])
        self.upright = np.array([_has_right_heading(each) for each in objects])
        self.marginals = np.array([each.marginals for each in objects])
        self.extents = np.array([each.extents for each in objects])
        self.seen_sides = np.array([each.seen_sides for each in objects])
        self.surface = np.array([[each.surface[level] for level in LEVELS] for each in objects])

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
    sides: SideMisfit
    matrices: Float[np.ndarray, "n 9 9"]
    """Of all objects, with these sides' errors."""
    needed: Mapping[str, Float[np.ndarray, "n l"]]
    pose: Float[np.ndarray, "f"]
    shape: Float[np.ndarray, "f"]
    usual: Mapping[str, Float[np.ndarray, "f"]]
    factors: Mapping[str, Float[np.ndarray, "l"]]


def _fitted(table: _Table, chosen: np.ndarray) -> _Fitted:
    X = table.X[chosen]
    sides = _sides(table, chosen & table.upright)
    matrices = sides.widened(table.marginals, table.extents, table.seen_sides)
    needed, usual, factors = table.needed(matrices), {}, {}
    for name in QUANTITIES:
        log_needed = np.log(np.clip(needed[name][chosen], *_NARROWEST_AND_WIDEST))
        usual[name] = _least_squares(X, log_needed[:, _NEAR_THE_TAIL])
        rest = log_needed - (X @ usual[name])[:, None]
        factors[name] = np.exp([_conformal(rest[:, i], float(level) / 100) for i, level in enumerate(LEVELS)])
    pose, shape = (_regression(X, right[chosen]) for right in (table.pose, table.shape))
    return _Fitted(sides, matrices, needed, pose, shape, usual, factors)


def _sides(table: _Table, chosen: np.ndarray) -> SideMisfit:
    """The likeliest, with Student's t in place of the normal distribution: a mask with a neighbour in it must not speak for all."""
    errors, marginals = table.errors[chosen], table.marginals[chosen]
    extents, seen = table.extents[chosen], table.seen_sides[chosen]

    def loss(log_values: np.ndarray) -> float:
        matrices = SideMisfit(*np.exp(log_values)).widened(marginals, extents, seen)
        squared = np.einsum("ni,ni->n", errors, np.linalg.solve(matrices, errors[..., None])[..., 0])
        spread = 0.5 * np.linalg.slogdet(matrices)[1]
        return float(np.mean(spread + 0.5 * (_STUDENT + 9) * np.log1p(squared / _STUDENT)))

    found = minimize(
        loss, np.log(_USUAL), method="Nelder-Mead", bounds=np.log(_POSSIBLE), options={"maxiter": 400}
    )
    return SideMisfit(*(float(value) for value in np.exp(found.x)))


def _conformal(scores: Float[np.ndarray, "n"], level: float) -> float:
    """The (n + 1) level-th smallest: what a further one is below with that probability at least."""
    rank = min(int(np.ceil((len(scores) + 1) * level)), len(scores))
    return float(np.sort(scores)[rank - 1])


def _least_squares(X: Float[np.ndarray, "n f"], y: Float[np.ndarray, "n"]) -> Float[np.ndarray, "f"]:
    return np.linalg.solve(X.T @ X + _ridge(X), X.T @ y)


def _regression(X: Float[np.ndarray, "n f"], right: Float[np.ndarray, "n"]) -> Float[np.ndarray, "f"]:
    """Coefficients of the log-odds. Two more objects, with the usual evidence, are one right and one wrong (Laplace's rule of
    succession): where all are right the next one need not be."""
    usual = np.eye(1, X.shape[1]).repeat(2, axis=0)
    X, right, ridge = np.concatenate([X, usual]), np.append(right, [1.0, 0.0]), _ridge(X)

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        odds = X @ w
        value = np.logaddexp(0, odds).sum() - right @ odds + 0.5 * w @ ridge @ w
        return float(value), X.T @ (_logistic(odds) - right) + ridge @ w

    return minimize(loss, np.zeros(X.shape[1]), jac=True, method="BFGS").x


def _ridge(X: Float[np.ndarray, "n f"]) -> Float[np.ndarray, "f f"]:
    return np.diag([_TINY, *[_RIDGE] * (X.shape[1] - 1)])


def _logistic(odds: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-odds))


def _category(objects: Sequence[Judged], prior: str) -> CategoryCalibration:
    table = _Table(objects)
    fitted = _fitted(table, np.ones(len(objects), bool))

    def named(values: np.ndarray) -> dict[str, float]:
        return dict(zip(NAMES, map(float, values), strict=True))

    def line(w: np.ndarray) -> Line:
        return Line(float(w[0]), named(w[1:]))

    widening = {
        name: Widening(
            line(fitted.usual[name]), dict(zip(LEVELS, map(float, fitted.factors[name]), strict=True))
        )
        for name in QUANTITIES
    }
    return CategoryCalibration(
        prior, len(objects), named(table.mean), named(table.spread), line(fitted.pose), line(fitted.shape), fitted.sides,
        widening,
    )  # fmt: skip


def _figures(some: Sequence[_Judgement]) -> dict[str, Any]:
    right, said = np.array([each.right for each in some], float), np.array([each.said for each in some])
    sure = said >= SURE
    held = {name: np.mean([each.held[name] for each in some], axis=0) for name in some[0].held}
    return {
        "objects": len(some),
        "right": float(right.mean()),
        "brier": float(np.mean((said - right) ** 2)),
        "brier_base": float(right.mean() * (1 - right.mean())),
        "sure": int(sure.sum()),
        "sure_right": float(right[sure].mean()) if sure.any() else None,
        "set_size_95": float(np.median([each.size for each in some])),
        "set_size_95_marginals": float(np.median([each.size_marginals for each in some])),
        **{f"{name}_{level}": float(held[name][i]) for name in held for i, level in enumerate(LEVELS)},
    }


def _size(matrix: Float[np.ndarray, "9 9"]) -> float:
    """Geometric mean of the standard deviations along the axes: radians, metres and shares alike."""
    return float(np.exp(np.linalg.slogdet(matrix)[1] / 18))
