"""Whether covariances hold: of the 9-DoF box against chi-squared, of the surface against its errors."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2, norm

from objgraph.bench.comparison.objects.calibrated import MEASURED as WITH_CALIBRATION
from objgraph.bench.comparison.objects.calibrated import of_rows
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.writing.bootstrap import Interval, Resamples, same_objects, with_intervals
from objgraph.covariance.box_modes import HEADING_AXIS
from objgraph.covariance.fused import intersection
from objgraph.metrics.pose import CONTINUOUS
from objgraph.trust.calibration import Calibration

LEVELS = (0.50, 0.90, 0.95)
RIGHT_MODE_DEG = 45.0
"""An estimate whose heading is farther off, modulo symmetry, has found another mode: no Gaussian about it knows of the
true one."""
DOF = 9
ALL = "all"
"""In the place of a category: all of them."""

MEASURED = (
    "coverage*: share of all objects, failures and wrong modes among them, whose 9-DoF box (rotation, centre, log-extents) lies in the "
    "estimate's ellipsoid of that probability; nees_per_dof: mean squared Mahalanobis error over 9, or 8 of what has no heading, of right modes (heading within 45 "
    "degrees modulo symmetry); nees_chi2: the middle 95 % of that mean if covariances held; nll: mean negative log-likelihood of the box, "
    "nats, of right modes; sharpness: geometric mean of the box's standard deviations, median; surface_*: of the signed distance at "
    "points of the true surface under a Gaussian with the propagated variance and the decoder's own; *_interval: bootstrap over shapes; "
    + WITH_CALIBRATION
)
"""What the numbers mean, for whoever reads the JSON alone."""
FUSED = "fused"
"""Method of the rows that are made of two others'."""
_OF = ("graph", "ours")
_ONE_MODE_DEG = 45.0
"""Estimates whose rotations differ by more are of different modes: the first one stands alone."""


class _Box(NamedTuple):
    """Of one object; NaN where there is no estimate with a covariance."""

    squared: float
    dof: int
    """One less of what has no heading."""
    right: bool
    nll: float
    sharpness: float


def calibration(
    rows: Sequence[ObjectRow], methods: Sequence[str], seed: int = 0, known: Calibration | None = None
) -> list[dict[str, Any]]:
    """One entry a method, number of views and category, and for all categories together; with what `known` makes of them."""
    views = sorted({row.views for row in rows})
    categories = [ALL, *dict.fromkeys(row.category for row in rows)]
    entries = []
    for name, count, category in product(methods, views, categories):
        chosen = [
            row
            for row in rows
            if (row.key[0], row.views) == (name, count) and category in (ALL, row.category)
        ]
        if any(row.box_covariance is not None for row in chosen):
            entries.append(_entry(name, count, category, chosen, seed, known))
    return entries


def holding_levels(rows: Sequence[ObjectRow]) -> Float[np.ndarray, "n"]:
    """Of right modes, each by its own degrees of freedom, the least probability whose ellipsoid holds the true box."""
    boxes = [box for box in map(_box, rows) if box.right]
    return chi2.cdf([box.squared for box in boxes], [box.dof for box in boxes])


def _entry(
    name: str, views: int, category: str, rows: Sequence[ObjectRow], seed: int, known: Calibration | None
) -> dict[str, Any]:
    draws = Resamples([row.shape for row in rows], seed)
    boxes = [_box(row) for row in rows]
    squared, right, dof = (
        np.array([getattr(box, name) for box in boxes]) for name in ("squared", "right", "dof")
    )
    n_right = int(right.sum())
    figures: dict[str, tuple[float | None, Interval]] = {}
    for level in LEVELS:
        held = (squared <= chi2.ppf(level, dof)).astype(float)  # False for NaN
        figures[f"coverage{100 * level:.0f}"] = draws.mean(held)
    figures["nees_per_dof"] = draws.mean(squared / dof, right)
    figures["nll"] = draws.mean(np.array([box.nll for box in boxes]), right)
    figures["sharpness"] = draws.median(np.array([box.sharpness for box in boxes]), right)
    for figure, values in _surfaces(rows).items():
        figures[figure] = draws.mean(values, ~np.isnan(values))
    by_known = {} if known is None else of_rows(rows, known)
    n_judged = int(np.sum(~np.isnan(by_known["pose_right"]))) if by_known else 0
    for figure, values in by_known.items():
        average = draws.median if figure == "set_size" else draws.mean
        figures[figure] = average(values, ~np.isnan(values))
    rate = figures.pop("pose_right", (None, None))[0]
    return {
        "contender": name,
        "method": rows[0].method,
        "start": rows[0].start,
        "views": views,
        "category": category,
        "n": len(rows),
        "n_failed": sum(row.failure is not None for row in rows),
        "n_right_mode": n_right,
        "wrong_modes": 1 - n_right / len(rows),
        "nees_chi2": [float(chi2.ppf(p, dof[right].sum()) / dof[right].sum()) for p in (0.025, 0.975)]
        if n_right
        else None,
        **({} if rate is None else {"n_judged": n_judged, "verdict_brier_base": rate * (1 - rate)}),
        **with_intervals(figures),
    }


def _box(row: ObjectRow) -> _Box:
    if row.box_error is None or row.box_covariance is None or row.heading_error_deg is None:
        return _Box(math.nan, DOF, False, math.nan, math.nan)
    error, matrix = np.array(row.box_error), np.array(row.box_covariance)
    if row.truth_symmetry == CONTINUOUS:
        known = [axis for axis in range(DOF) if axis not in HEADING_AXIS]
        error, matrix = error[known], matrix[np.ix_(known, known)]
    dof = len(error)
    sign, log_det = np.linalg.slogdet(matrix)
    if sign <= 0:
        return _Box(math.inf, dof, False, math.nan, math.nan)
    squared = float(error @ np.linalg.solve(matrix, error))
    right = row.heading_error_deg <= RIGHT_MODE_DEG
    nll = 0.5 * (squared + log_det + dof * math.log(2 * math.pi))
    return _Box(squared, dof, right, nll, float(np.exp(log_det / (2 * dof))))


def _surfaces(rows: Sequence[ObjectRow]) -> dict[str, Float[np.ndarray, "n"]]:
    """Figures of each object's surface; NaN where there are none, or the object is not well reconstructed."""
    found = [_surface(row) if row.well_reconstructed else {} for row in rows]
    names = ["pearson_surface", "pearson_binned", "spearman_surface", "surface_nees", "surface_nll"]
    names += [f"surface_coverage{100 * level:.0f}" for level in LEVELS]
    return {name: np.array([one.get(name) for one in found], dtype=float) for name in names}


def _surface(row: ObjectRow) -> dict[str, float | None]:
    if row.surface_error is None or row.surface_sigma is None or row.surface_residual is None:
        return {}
    sigma = np.hypot(np.array(row.surface_sigma), row.surface_residual)
    z = np.array(row.surface_error) / sigma
    nll = 0.5 * z**2 + np.log(sigma) + 0.5 * math.log(2 * math.pi)
    held = {
        f"surface_coverage{100 * level:.0f}": float(np.mean(z <= norm.ppf(0.5 + level / 2)))
        for level in LEVELS
    }
    return {
        "pearson_surface": row.pearson,
        "pearson_binned": row.pearson_binned,
        "spearman_surface": row.spearman,
        "surface_nees": float(np.mean(z**2)),
        "surface_nll": float(np.mean(nll)),
        **held,
    }


def with_fused(rows: Sequence[ObjectRow], methods: Sequence[str]) -> tuple[list[ObjectRow], list[str]]:
    """Rows and methods, and `fused` where both of its parts are there: covariance intersection in equal shares.

    Both covariances are from the same data, so information is shared out, not added (see `objgraph.covariance.fused`).
    Errors to the truth are in the tangents of two estimates of one mode, which to first order are one.
    """
    if not set(_OF) <= set(methods):
        return [*rows], [*methods]
    made = [_fused(a, b) for a, b in same_objects(rows, *_OF)]
    return [*rows, *made], [*methods, FUSED]


def _fused(a: ObjectRow, b: ObjectRow) -> ObjectRow:
    alone = replace(a, method=FUSED, surface_error=None, surface_sigma=None, pearson=None, spearman=None)
    if a.box_error is None or b.box_error is None or a.box_covariance is None or b.box_covariance is None:
        return alone
    R_a, R_b = (np.array(row.T_world_object, dtype=float)[:3, :3] for row in (a, b))
    if np.degrees(np.arccos(np.clip((np.trace(R_a.T @ R_b) - 1) / 2, -1, 1))) > _ONE_MODE_DEG:
        return alone
    matrix, of_b = intersection(np.array(a.box_covariance), np.array(b.box_covariance))
    error = np.array(a.box_error)
    error = error + of_b @ (np.array(b.box_error) - error)
    return replace(alone, box_error=error.tolist(), box_covariance=matrix.tolist())
