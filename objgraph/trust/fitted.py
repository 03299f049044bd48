"""What a calibration is fitted to, and the fit to chosen objects of each category."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

from objgraph.covariance.box_modes import EVERY_AXIS, HEADING_AXIS, factor_needed
from objgraph.covariance.quantile import squared_limit
from objgraph.covariance.sides import SideMisfit
from objgraph.trust.calibration import LEVELS, QUANTITIES, deviations
from objgraph.trust.evidence import NAMES, Evidence
from objgraph.trust.regression import conformal, least_squares, log_odds, stacked

RIGHT_HEADING = 0.35
"""Radians; the paper's 20 degrees."""
_STUDENT = 5.0
"""Degrees of freedom."""
_USUAL = (2.0, 0.015, 0.1)
"""Where the search for the sides' misfit begins."""
_POSSIBLE = ((0.1, 100.0), (1e-3, 0.2), (0.015, 1.0))
"""Of them the last: what nobody sees is known no better than to so much of the extent, however well the prior guesses it."""
_NEAR_THE_TAIL = 1
"""Which of the levels the evidence has to explain."""
_NARROWEST_AND_WIDEST = (1e-3, 1e9)
"""Factors beyond which it does not matter: the heading of what is round has no error at all."""
_MOST = np.array([0.0 if name == "seen" else np.inf for name in NAMES])
"""Of the weights of the evidence: what is seen more is never wider for that."""
_CONSTANT = 1e-9
"""Spread of evidence that has none."""
FOLDS = 10


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


def has_right_heading(each: Judged) -> bool:
    return bool(abs(each.modes[0][1][1]) < RIGHT_HEADING)


class Table:
    """Objects of a category as arrays."""

    def __init__(self, objects: Sequence[Judged]) -> None:
        given = np.array([[each.evidence.to_json()[name] for name in NAMES] for each in objects])
        self.mean, spread = given.mean(axis=0), given.std(axis=0)
        # what is the same for all, as a guess where there is none, tells nothing of how far another may be off it
        self.spread = np.where(spread > _CONSTANT, spread, 1.0)
        self.shapes = [each.shape for each in objects]
        self.X = np.concatenate(
            [np.ones((len(objects), 1)), deviations(given, self.mean, self.spread)], axis=1
        )
        self.pose = np.array([each.pose_right for each in objects], float)
        self.shape = np.array([each.shape_right for each in objects], float)
        self.modes = [each.modes for each in objects]
        self.errors = np.array([each.modes[0][1] for each in objects])
        self.upright = np.array([has_right_heading(each) for each in objects])
        self.marginals = np.array([each.marginals for each in objects])
        self.extents = np.array([each.extents for each in objects])
        self.seen_sides = np.array([each.seen_sides for each in objects])
        self.surface = np.array([[each.surface[level] for level in LEVELS] for each in objects])

    def folds(self, seed: int = 0) -> Int[np.ndarray, "n"]:
        """Each object's, by its shape."""
        return folds_of(self.shapes, seed)

    @cached_property
    def by_marginals(self) -> Float[np.ndarray, "n l"]:
        """Of boxes by the marginals as they are."""
        return self.needed(self.marginals)["box"]

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


def folds_of(shapes: Sequence[str], seed: int = 0) -> Int[np.ndarray, "n"]:
    """The fold of each object, by its shape, drawn at random."""
    names = sorted(set(shapes))
    of_shape = dict(zip(names, np.random.default_rng(seed).permutation(len(names)) % FOLDS, strict=True))
    return np.array([of_shape[shape] for shape in shapes])


@dataclass(frozen=True)
class _Widths:
    """Boxes with their sides' errors, and how much wider they should have been."""

    sides: SideMisfit
    matrices: Float[np.ndarray, "n 9 9"]
    needed: Mapping[str, Float[np.ndarray, "n l"]]

    def log_needed(self, name: str) -> Float[np.ndarray, "n l"]:
        return np.log(np.clip(self.needed[name], *_NARROWEST_AND_WIDEST))


@dataclass(frozen=True)
class Fitted:
    """To the chosen objects of a category: what a calibration of it consists of, and what all of its objects need by it."""

    sides: SideMisfit
    matrices: Float[np.ndarray, "n 9 9"]
    """Of all objects, with these sides' errors."""
    needed: Mapping[str, Float[np.ndarray, "n l"]]
    pose: Float[np.ndarray, "f"]
    shape: Float[np.ndarray, "f"]
    usual: Mapping[str, Float[np.ndarray, "f"]]
    factors: Mapping[str, Float[np.ndarray, "l"]]


def fits(tables: Mapping[str, Table], chosen: Mapping[str, np.ndarray]) -> dict[str, Fitted]:
    """Of each category, by the chosen of its objects. What evidence is worth is much the same for all, and each category's own
    weights are held to the common ones."""
    if not tables:
        return {}
    widths = {name: _widths(table, chosen[name]) for name, table in tables.items()}
    pose, shape = ({name: getattr(table, of) for name, table in tables.items()} for of in ("pose", "shape"))
    poses, shapes = (_lines(log_odds, tables, of, chosen) for of in (pose, shape))
    usual, factors = {}, {}
    for of in QUANTITIES:
        log_needed = {name: each.log_needed(of) for name, each in widths.items()}
        usual[of], factors[of] = _widenings(tables, log_needed, chosen)
    return {
        name: Fitted(
            each.sides, each.matrices, each.needed, poses[name], shapes[name],
            {of: usual[of][name] for of in QUANTITIES}, {of: factors[of][name] for of in QUANTITIES},
        )
        for name, each in widths.items()
    }  # fmt: skip


def _widenings(
    tables: Mapping[str, Table], log_needed: Mapping[str, np.ndarray], chosen: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, Float[np.ndarray, "l"]]]:
    """Of each category the line of what its boxes need, and by level the factor over it. What is left over a line that saw the
    same shapes is too small, so that of each fold is what it needs over a line of the others (Vovk, "Cross-conformal
    predictors", 2015)."""
    fit = partial(least_squares, most=_MOST)
    tail = {name: log_needed[name][:, _NEAR_THE_TAIL] for name in tables}
    lines = _lines(fit, tables, tail, chosen)
    folds = {name: table.folds() for name, table in tables.items()}
    left = {name: log_needed[name] - (table.X @ lines[name])[:, None] for name, table in tables.items()}
    for k in range(FOLDS):
        others = {name: chosen[name] & (fold != k) for name, fold in folds.items()}
        some = {name: table for name, table in tables.items() if others[name].any()}
        for name, line in _lines(fit, some, tail, others).items():
            own = folds[name] == k
            left[name][own] = log_needed[name][own] - (tables[name].X[own] @ line)[:, None]
    levels = [float(level) / 100 for level in LEVELS]
    factors = {
        name: np.exp([conformal(left[name][chosen[name], i], level) for i, level in enumerate(levels)])
        for name in tables
    }
    return lines, factors


def _lines(
    fit: Callable[..., np.ndarray],
    tables: Mapping[str, Table],
    of: Mapping[str, Float[np.ndarray, "n"]],
    chosen: Mapping[str, np.ndarray],
) -> dict[str, Float[np.ndarray, "f"]]:
    """Of each category, its weights held to those that all share."""
    parts = {name: (table.X[chosen[name]], of[name][chosen[name]]) for name, table in tables.items()}
    common = fit(*stacked([*parts.values()]), len(parts))[len(parts) :] if parts else None
    return {name: fit(*part, toward=common) for name, part in parts.items()}


def _widths(table: Table, chosen: np.ndarray) -> _Widths:
    sides = likeliest_sides(table, chosen & table.upright)
    matrices = sides.widened(table.marginals, table.extents, table.seen_sides)
    return _Widths(sides, matrices, table.needed(matrices))


def likeliest_sides(table: Table, chosen: np.ndarray) -> SideMisfit:
    """By which the chosen objects' errors are likeliest."""

    def loss(log_values: np.ndarray) -> float:
        return unlikelihood(SideMisfit(*map(float, np.exp(log_values))), table, chosen)

    # a simplex collapses onto the bounds
    found = minimize(loss, np.log(_USUAL), method="L-BFGS-B", bounds=np.log(_POSSIBLE))
    return SideMisfit(*(float(value) for value in np.exp(found.x)))


def unlikelihood(sides: SideMisfit, table: Table, chosen: np.ndarray) -> float:
    """Mean negative log-likelihood of the chosen objects' errors, but for a constant: Student's t in place of the normal
    distribution, since a mask with a neighbour in it must not speak for all."""
    errors = table.errors[chosen]
    matrices = sides.widened(table.marginals[chosen], table.extents[chosen], table.seen_sides[chosen])
    squared = np.einsum("ni,ni->n", errors, np.linalg.solve(matrices, errors[..., None])[..., 0])
    spread = 0.5 * np.linalg.slogdet(matrices)[1]
    return float(np.mean(spread + 0.5 * (_STUDENT + 9) * np.log1p(squared / _STUDENT)))
