"""Percentile bootstrap over distinct shapes: objects of one CAD model are drawn together."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from objgraph.bench.comparison.running.store import R

LEVEL = 0.95
RESAMPLES = 2000

Interval = tuple[float, float] | None


class Resamples:
    """How often each row is in each resample of the shapes."""

    weights: Int[np.ndarray, "b n"]

    def __init__(self, shapes: Sequence[str], seed: int = 0, count: int = RESAMPLES) -> None:
        """`shapes` has the shape of every row."""
        names, index = np.unique(np.asarray(shapes, dtype=str), return_inverse=True)
        self.shapes, self._index = len(names), index
        even = np.full(self.shapes, 1 / max(self.shapes, 1))
        self.weights = np.random.default_rng(seed).multinomial(self.shapes, even, size=count)[:, index]

    def mean(
        self, values: Float[np.ndarray, "n"], where: Bool[np.ndarray, "n"] | None = None
    ) -> tuple[float | None, Interval]:
        """The mean of the rows (of those of `where`), and its interval."""
        chosen = np.ones(len(values), bool) if where is None else where
        if not chosen.any():
            return None, None
        weights, part = self.weights[:, chosen], values[chosen]
        total = weights.sum(axis=1)
        drawn = total > 0
        return float(part.mean()), self._interval((weights @ part)[drawn] / total[drawn], chosen)

    def median(
        self, values: Float[np.ndarray, "n"], where: Bool[np.ndarray, "n"] | None = None
    ) -> tuple[float | None, Interval]:
        """The same of the median; values may be infinite, and so may be what comes out: its interval is then never None, by which
        JSON tells it from what there is none of."""
        chosen = np.ones(len(values), bool) if where is None else where
        if not chosen.any():
            return None, None
        weights, part = self.weights[:, chosen], values[chosen]
        drawn, middle = weights.sum(axis=1) > 0, float(np.median(part))
        interval = self._interval(weighted_medians(part, weights[drawn]), chosen)
        return middle, (middle, middle) if interval is None and math.isinf(middle) else interval

    def _interval(self, samples: Float[np.ndarray, "b"], chosen: Bool[np.ndarray, "n"]) -> Interval:
        """The middle 95 %; None where a single shape is chosen, of which nothing can be said."""
        if len(np.unique(self._index[chosen])) < 2 or not len(samples):
            return None
        # without interpolation, which infinity does not bear
        low = np.quantile(samples, (1 - LEVEL) / 2, method="lower")
        high = np.quantile(samples, (1 + LEVEL) / 2, method="higher")
        return float(low), float(high)


def weighted_medians(
    values: Float[np.ndarray, "n"], weights: Int[np.ndarray, "b n"]
) -> Float[np.ndarray, "b"]:
    """`np.median` of the values repeated by each row of weights."""
    order = np.argsort(values, kind="stable")
    upto = np.cumsum(weights[:, order], axis=1)
    total = upto[:, -1:]
    middle = [np.argmax(upto > k, axis=1) for k in ((total - 1) // 2, total // 2)]
    return (values[order][middle[0]] + values[order][middle[1]]) / 2


def with_intervals(figures: Mapping[str, tuple[float | None, Interval]]) -> dict[str, Any]:
    """Each figure and, under its name and `_interval`, its interval; what is not finite is None."""
    found: dict[str, Any] = {}
    for name, (value, interval) in figures.items():
        found[name] = _finite(value)
        found[f"{name}_interval"] = None if interval is None else [_finite(end) for end in interval]
    return found


def same_objects(rows: Sequence[R], a: str, b: str) -> list[tuple[R, R]]:
    """The rows of two methods on each object that both have."""
    first, second = ({row.key[1:]: row for row in rows if row.key[0] == name} for name in (a, b))
    return [(row, second[key]) for key, row in first.items() if key in second]


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
