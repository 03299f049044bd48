"""The graph's box and the paper's as one, for the calibration report: from their rows, nothing is estimated again."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from objgraph.bench.comparison.rows import ObjectRow

FUSED = "fused"
"""Method of the rows so made."""
_OF = ("graph", "ours")
_ONE_MODE_DEG = 45.0
"""Estimates whose rotations differ by more are of different modes: the first one stands alone."""


def with_fused(rows: Sequence[ObjectRow], methods: Sequence[str]) -> tuple[list[ObjectRow], list[str]]:
    """Rows and methods, and `fused` where both of its parts are there: covariance intersection in equal shares.

    Both covariances are from the same data, so information is shared out, not added (see `objgraph.covariance.fused`).
    Errors to the truth are in the tangents of two estimates of one mode, which to first order are one.
    """
    if not set(_OF) <= set(methods):
        return [*rows], [*methods]
    first, second = ({(r.case, r.views): r for r in rows if r.method == name} for name in _OF)
    made = [_fused(row, second[key]) for key, row in first.items() if key in second]
    return [*rows, *made], [*methods, FUSED]


def _fused(a: ObjectRow, b: ObjectRow) -> ObjectRow:
    alone = replace(a, method=FUSED, surface_error=None, surface_sigma=None, pearson=None, spearman=None)
    if a.box_error is None or b.box_error is None or a.box_covariance is None or b.box_covariance is None:
        return alone
    R_a, R_b = (np.array(row.T_world_object, dtype=float)[:3, :3] for row in (a, b))
    if np.degrees(np.arccos(np.clip((np.trace(R_a.T @ R_b) - 1) / 2, -1, 1))) > _ONE_MODE_DEG:
        return alone
    of_a, of_b = np.linalg.inv(np.array(a.box_covariance)) / 2, np.linalg.inv(np.array(b.box_covariance)) / 2
    matrix = np.linalg.inv(of_a + of_b)
    error = matrix @ (of_a @ np.array(a.box_error) + of_b @ np.array(b.box_error))
    return replace(alone, box_error=error.tolist(), box_covariance=(0.5 * (matrix + matrix.T)).tolist())
