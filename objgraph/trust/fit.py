"""From objects with ground truth to a calibration, and what it gives on objects that were held out.

Verdicts are logistic regressions. Sets are calibrated by cross-conformal prediction (Vovk, "Cross-conformal predictors", 2015) of
a normalised score (Lei et al., JASA 2018): how much an object's covariance would have had to be widened, over what its evidence
lets expect by a fit to other shapes. Folds are of shapes, so no object is judged by a fit that saw its shape.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from objgraph.errors import CovarianceError
from objgraph.trust.calibration import LEVELS, QUANTITIES, Calibration, CategoryCalibration, Line, Widening
from objgraph.trust.evidence import NAMES
from objgraph.trust.fitted import Fitted, Judged, Table, fits, has_right_heading
from objgraph.trust.held_out import held_out

LEAST = 40
"""Objects of a category below which nothing can be said of 95 %."""
LEAST_RIGHT = 10
"""Of them with the right heading."""


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
    tables = {name: Table(some) for name, some in enough.items()}
    fitted = fits(tables, {name: np.ones(len(some), bool) for name, some in enough.items()})
    categories = {name: _category(tables[name], fitted[name], priors[name]) for name in enough}
    kept = [each for some in enough.values() for each in some]
    return Calibration(categories, {**made, "too_few": few, "held_out": held_out(kept, seed)})


def _is_enough(objects: Sequence[Judged]) -> bool:
    return len(objects) >= LEAST and sum(has_right_heading(each) for each in objects) >= LEAST_RIGHT


def _category(table: Table, fitted: Fitted, prior: str) -> CategoryCalibration:
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
        prior, len(table.X), named(table.mean), named(table.spread), line(fitted.pose), line(fitted.shape), fitted.sides,
        widening,
    )  # fmt: skip
