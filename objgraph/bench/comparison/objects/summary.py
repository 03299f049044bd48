"""What the rows of objects say of methods: rates, medians and correlations, and differences on the same objects."""

import math
from collections.abc import Callable, Sequence
from itertools import product
from operator import attrgetter
from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.objects.uncertainty import SurfaceErrors, gaussian_pearson
from objgraph.bench.comparison.writing.against import against
from objgraph.bench.comparison.writing.bootstrap import Resamples, same_objects, with_intervals

WORST = {"chamfer_m": 1.0, "translation_m": 1.0, "rotation_deg": 180.0}
"""What an error counts as at most in a difference; a failure's counts as this."""

Group = tuple[str, int]
"""Category, views."""


def summarize(rows: Sequence[ObjectRow], methods: Sequence[str], seed: int = 0) -> list[dict[str, Any]]:
    """One entry a contender, category and number of views; every figure has its interval beside it.

    Medians count a failure as infinite; where that is what comes out, it is None, as is the end of an interval.
    """
    return [
        _entry(name, group, chosen, seed)
        for group, name in product(groups(rows), methods)
        if (chosen := select(rows, name, group))
    ]


def paired(rows: Sequence[ObjectRow], methods: Sequence[str], seed: int = 0) -> list[dict[str, Any]]:
    """For a and b of `against`, the median of a's error less b's on the same objects: below zero where a is better.

    Errors are cut off at `WORST`. The correlations are compared by their mean difference over the objects that both
    reconstruct well.
    """
    return [
        _difference(a, b, group, common, seed)
        for group in groups(rows)
        for a, b in against(methods)
        if (common := same_objects([row for row in rows if (row.category, row.views) == group], a, b))
    ]


def groups(rows: Sequence[ObjectRow]) -> list[Group]:
    """Categories in the rows' order, each with its numbers of views."""
    return list(dict.fromkeys((row.category, row.views) for row in _by_views(rows)))


def select(rows: Sequence[ObjectRow], name: str, group: Group) -> list[ObjectRow]:
    """The rows of one contender, category and number of views."""
    return [row for row in rows if row.key[0] == name and (row.category, row.views) == group]


def _by_views(rows: Sequence[ObjectRow]) -> list[ObjectRow]:
    categories = list(dict.fromkeys(row.category for row in rows))
    return sorted(rows, key=lambda row: (categories.index(row.category), row.views))


def _entry(name: str, group: Group, rows: Sequence[ObjectRow], seed: int) -> dict[str, Any]:
    draws = Resamples([row.shape for row in rows], seed)
    known = np.array([row.well_reconstructed and row.pearson is not None for row in rows])
    binned = known & np.array([row.pearson_binned is not None for row in rows])
    timed = np.array([row.failure is None and row.seconds is not None for row in rows])
    begun = np.array([row.start_seconds is not None for row in rows])
    metres = np.array([_in_metres(row) for row in rows])
    figures = {
        "pose_rate": draws.mean(_values(rows, lambda row: row.pose_correct)),
        "iou_rate": draws.mean(_values(rows, lambda row: row.iou_correct)),
        "chamfer_rate": draws.mean(_values(rows, lambda row: row.chamfer_correct)),
        "pearson": draws.mean(_values(rows, lambda row: row.pearson), known),
        "pearson_binned": draws.mean(_values(rows, lambda row: row.pearson_binned), binned),
        "pearson_metres": draws.mean(metres[:, 0], known & ~np.isnan(metres[:, 0])),
        "pearson_metres_gaussian": draws.mean(metres[:, 1], known & ~np.isnan(metres[:, 1])),
        "median_translation_m": draws.median(_values(rows, lambda row: row.translation_m)),
        "median_rotation_deg": draws.median(_values(rows, lambda row: row.rotation_deg)),
        "median_chamfer_m": draws.median(_values(rows, lambda row: row.chamfer_m)),
        "seconds": draws.median(_values(rows, lambda row: row.seconds), timed),
        "seconds_cpu": draws.median(_values(rows, lambda row: row.seconds_cpu), timed),
        "start_seconds": draws.median(_values(rows, lambda row: row.start_seconds), begun),
    }
    return {
        "contender": name,
        "method": rows[0].method,
        "start": rows[0].start,
        "difficulty": rows[0].difficulty,
        "shapes": rows[0].shapes,
        "category": group[0],
        "views": group[1],
        "n": len(rows),
        "n_shapes": draws.shapes,
        "n_failed": sum(row.failure is not None for row in rows),
        "n_well": int(known.sum()),
        **with_intervals(figures),
    }


def _in_metres(row: ObjectRow) -> tuple[float, float]:
    """Correlation of error and standard deviation over the row's own points, and what Gaussian errors would have."""
    if row.surface_error is None or row.surface_sigma is None:
        return math.nan, math.nan
    kept = SurfaceErrors(np.array(row.surface_error), np.array(row.surface_sigma))
    found, gaussian = kept.pearson, gaussian_pearson(kept.sigma)
    return math.nan if found is None else found, math.nan if gaussian is None else gaussian


def _difference(
    a: str, b: str, group: Group, pairs: Sequence[tuple[ObjectRow, ObjectRow]], seed: int
) -> dict[str, Any]:
    draws = Resamples([row.shape for row, _ in pairs], seed)
    both = np.array([_correlated(x) and _correlated(y) for x, y in pairs])
    figures = {
        f"median_{name}": draws.median(_errors(pairs, 0, name) - _errors(pairs, 1, name)) for name in WORST
    }
    first, second = (_values([pair[i] for pair in pairs], lambda row: row.pearson) for i in (0, 1))
    figures["mean_pearson"] = draws.mean(np.where(both, first, 0.0) - np.where(both, second, 0.0), both)
    return {
        "a": a,
        "b": b,
        "category": group[0],
        "views": group[1],
        "n": len(pairs),
        "n_shapes": draws.shapes,
        "n_both_well": int(both.sum()),
        **with_intervals(figures),
    }


def _errors(pairs: Sequence[tuple[ObjectRow, ObjectRow]], side: int, name: str) -> Float[np.ndarray, "n"]:
    """One method's errors, cut off at the worst that counts."""
    return np.minimum(_values([pair[side] for pair in pairs], attrgetter(name)), WORST[name])


def _correlated(row: ObjectRow) -> bool:
    return row.well_reconstructed and row.pearson is not None


def _values(rows: Sequence[ObjectRow], value: Callable[[ObjectRow], float | None]) -> Float[np.ndarray, "n"]:
    """One number a row; what is not there is infinitely bad."""
    return np.array([math.inf if (x := value(row)) is None else float(x) for row in rows])
