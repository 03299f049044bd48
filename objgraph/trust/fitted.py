"""What a calibration is fitted to, and the fit to chosen objects of each category."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
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


@dataclass(frozen=True)
class _Widths:
    """Boxes with their sides' errors, and how much wider they should have been."""

    sides: SideMisfit
    matrices: Float[np.ndarray, "n 9 9"]
    needed: Mapping[str, Float[np.ndarray, "n l"]]

    def log_needed(self, name: str, chosen: np.ndarray) -> Float[np.ndarray, "m l"]:
        return np.log(np.clip(self.needed[name][chosen], *_NARROWEST_AND_WIDEST))

    def usual(self, name: str, chosen: np.ndarray) -> Float[np.ndarray, "m"]:
        """What the evidence has to explain."""
        return self.log_needed(name, chosen)[:, _NEAR_THE_TAIL]


@dataclass(frozen=True)
class _Common:
    """Weights of the evidence that all categories share."""

    pose: Float[np.ndarray, "f-1"]
    shape: Float[np.ndarray, "f-1"]
    usual: Mapping[str, Float[np.ndarray, "f-1"]]


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
    pose, shape, usual = [], [], {name: [] for name in QUANTITIES}
    widths = {name: _widths(table, chosen[name]) for name, table in tables.items()}
    for name, table in tables.items():
        X = table.X[chosen[name]]
        pose.append((X, table.pose[chosen[name]]))
        shape.append((X, table.shape[chosen[name]]))
        for of in QUANTITIES:
            usual[of].append((X, widths[name].usual(of, chosen[name])))
    common = _Common(
        log_odds(*stacked(pose), len(tables))[len(tables) :],
        log_odds(*stacked(shape), len(tables))[len(tables) :],
        {of: least_squares(*stacked(usual[of]), len(tables), most=_MOST)[len(tables) :] for of in QUANTITIES},
    )
    return {name: _fitted(table, chosen[name], widths[name], common) for name, table in tables.items()}


def _fitted(table: Table, chosen: np.ndarray, widths: _Widths, common: _Common) -> Fitted:
    X, usual, factors = table.X[chosen], {}, {}
    for name in QUANTITIES:
        log_needed = widths.log_needed(name, chosen)
        usual[name] = least_squares(X, widths.usual(name, chosen), toward=common.usual[name], most=_MOST)
        rest = log_needed - (X @ usual[name])[:, None]
        factors[name] = np.exp([conformal(rest[:, i], float(level) / 100) for i, level in enumerate(LEVELS)])
    pose = log_odds(X, table.pose[chosen], toward=common.pose)
    shape = log_odds(X, table.shape[chosen], toward=common.shape)
    return Fitted(widths.sides, widths.matrices, widths.needed, pose, shape, usual, factors)


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
