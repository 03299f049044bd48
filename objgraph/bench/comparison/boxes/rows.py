"""One row a method and detected object of single scans, and what rows say of methods (the paper's Table III)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from objgraph.bench.comparison.writing.against import against
from objgraph.bench.comparison.writing.bootstrap import Resamples, same_objects, with_intervals

DETECTIONS = "detections"
"""The name under which the detected boxes themselves stand among the methods."""
IOUS = {"iou60": 0.6, "iou75": 0.75}
POINTS_EDGES = (50, 100, 300, 1000)
DISTANCE_EDGES = (10.0, 20.0, 40.0)


@dataclass(frozen=True)
class BoxRow:
    """What one method made of one detected object. None where there is no such value."""

    method: str
    frame: str
    detection: int
    settings: str
    """Digest of all settings and weights that this row depends on."""
    category: str = "car"
    failure: str | None = None
    """Why there is no estimate; its IoU counts as 0."""
    label: int | None = None
    """Number of the labelled object that it is; None where no label is near enough or the frame cannot be read, and it is
    not counted."""
    points: int | None = None
    """Returns in the labelled box."""
    distance_m: float | None = None
    """From the sensor to the middle of the labelled box."""
    iou: float | None = None
    """Of the oriented boxes."""
    error_m: list[float] | None = None
    """From the label's middle to the estimate's along the label's axes: right, up, back."""
    heading_deg: float | None = None
    size_error_m: list[float] | None = None
    """Estimated less labelled edges: width, height, length."""
    sigma_m: list[float] | None = None
    """Standard deviation of the box' middle along its own axes."""
    seconds: float | None = None
    """By the clock, from points and box to the estimate; a frame's objects share it evenly."""
    seconds_cpu: float | None = None
    T_world_object: list[list[float]] | None = None
    size_m: list[float] | None = None
    version: str = ""

    @property
    def key(self) -> tuple[str, str, int]:
        return (self.method, self.frame, self.detection)

    @property
    def group(self) -> str:
        """Rows of equal ones have the same settings."""
        return self.method

    @property
    def what(self) -> str:
        """The object, in words."""
        return f"frame {self.frame}, {self.detection}"


def counted(rows: Iterable[BoxRow], least_points: int) -> list[BoxRow]:
    """Rows of labelled objects with that many returns."""
    return [row for row in rows if row.points is not None and row.points >= least_points]


def summarize(rows: Sequence[BoxRow], methods: Sequence[str], seed: int = 0) -> list[dict[str, Any]]:
    """One entry a method: figures with their intervals (bootstrap over objects), whole and by points and distance."""
    entries = []
    for name in methods:
        chosen = [row for row in rows if row.method == name]
        if not chosen:
            continue
        seconds = [row.seconds for row in chosen if row.seconds is not None]
        entries.append(
            {
                "method": name,
                "n_failed": sum(row.failure is not None for row in chosen),
                **_figures(chosen, seed),
                "seconds": float(np.median(seconds)) if seconds else None,
                "by_points": _by([row.points or 0 for row in chosen], chosen, POINTS_EDGES, seed),
                "by_distance_m": _by([row.distance_m or 0.0 for row in chosen], chosen, DISTANCE_EDGES, seed),
            }
        )
    return entries


def paired(rows: Sequence[BoxRow], methods: Sequence[str], seed: int = 0) -> list[dict[str, Any]]:
    """For a and b of `against`, the mean of a's IoU less b's on the same objects: above zero where a is better."""
    found = []
    for a, b in against(methods):
        if common := same_objects(rows, a, b):
            draws = Resamples([f"{row.frame}/{row.label}" for row, _ in common], seed)
            difference = np.array([(x.iou or 0.0) - (y.iou or 0.0) for x, y in common])
            figures = with_intervals({"mean_iou": draws.mean(difference)})
            found.append({"a": a, "b": b, "n": len(common), **figures})
    return found


def _by(
    values: Sequence[float], rows: Sequence[BoxRow], edges: Sequence[float], seed: int
) -> list[dict[str, Any]]:
    """The same figures of the rows between each two edges."""
    bounds = [0.0, *edges, np.inf]
    found = []
    for low, high in pairwise(bounds):
        part = [row for row, value in zip(rows, values, strict=True) if low <= value < high]
        if part:
            found.append({"from": low, "to": None if np.isinf(high) else high, **_figures(part, seed)})
    return found


def _figures(rows: Sequence[BoxRow], seed: int) -> dict[str, Any]:
    draws = Resamples([f"{row.frame}/{row.label}" for row in rows], seed)
    iou = np.array([row.iou or 0.0 for row in rows])
    figures = {"mean_iou": draws.mean(iou)}
    figures |= {name: draws.mean((iou > limit).astype(float)) for name, limit in IOUS.items()}
    return {"n": len(rows), **with_intervals(figures)}
