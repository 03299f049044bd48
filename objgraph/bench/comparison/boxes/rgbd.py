"""What is reported of RGB-D scans whose ground truth is boxes alone: how well boxes agree, by how well the true ones are known."""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from objgraph.bench.comparison.objects.compare import Comparison, starts_apart
from objgraph.bench.comparison.objects.config import prior_hash, row_settings
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.writing import published
from objgraph.bench.comparison.writing.bootstrap import LEVEL, Resamples, with_intervals
from objgraph.bench.comparison.writing.grid import NONE, Cell, Grid, ranged
from objgraph.bench.comparison.writing.report import Entry, Report
from objgraph.metrics.objects import IOU_LIMIT

MEASURED = (
    "of oriented boxes, the estimate's about its mesh; quality: full, or partial where the true box' sides were not all "
    f"seen; iou_rate: share of objects with an IoU above {IOU_LIMIT}; box_iou: a failure counts as 0; translation_m: "
    "distance of the centres; heading_error_deg: about the up axis, of a table modulo half turns; scale_pct: deviation from "
    "one of the mean ratio of edges, scale_pct_max: of the worst edge; medians: a failure is infinite, null where that "
    "comes out; *_interval: percentile bootstrap over objects; seconds_cpu: median processor time of the estimation alone"
)
UNKNOWN = "unknown"
"""The quality of an object that failed before its truth was read."""
_ERRORS = ("translation_m", "heading_error_deg", "scale_pct", "scale_pct_max")
_NAMES = ("centre\n(cm)", "heading\n(deg)", "size\n(%)", "worst edge\n(%)")
_SCALES = ((100, 1), (1, 1), (1, 1), (1, 1))
"""Of each error in a table: factor and digits."""


def rgbd_box_report(comparison: Comparison, rows: Sequence[ObjectRow]) -> Report:
    """Medians by quality and number of views, then every object by itself."""
    entries = summarize_boxes(rows, comparison.methods, comparison.config.seed)
    dataset = comparison.source.dataset
    categories = list(dict.fromkeys(row.category for row in rows))
    return Report(
        comparison.config.seed,
        rows,
        entries,
        [],
        [_medians(entries, dataset), _objects(rows, dataset)],
        {
            "starts_apart": len(starts_apart(rows)),
            "settings": {
                name: row_settings(comparison.source, comparison.config, name, categories[0])
                for name in comparison.methods
            },
            "priors": {category: prior_hash(category, comparison.config) for category in categories},
        },
        "objects",
        MEASURED,
    )


def summarize_boxes(rows: Sequence[ObjectRow], methods: Sequence[str], seed: int = 0) -> list[Entry]:
    """One entry a quality, number of views and contender; every figure has its interval beside it."""
    groups = sorted({(_quality(row), row.views) for row in rows})
    return [
        _entry(name, quality, views, chosen, seed)
        for (quality, views), name in product(groups, methods)
        if (chosen := [row for row in rows if (row.contender, _quality(row), row.views) == (name, quality, views)])
    ]  # fmt: skip


def _entry(name: str, quality: str, views: int, rows: Sequence[ObjectRow], seed: int) -> Entry:
    draws = Resamples([row.shape for row in rows], seed)
    timed = np.array([row.failure is None and row.seconds_cpu is not None for row in rows])

    def values(of: Callable[[ObjectRow], float | None], otherwise: float = np.inf) -> np.ndarray:
        return np.array([otherwise if (x := of(row)) is None else float(x) for row in rows])

    figures = {
        "iou_rate": draws.mean(values(lambda row: row.iou_correct)),
        "median_box_iou": draws.median(values(lambda row: row.box_iou, 0.0)),
        **{
            f"median_{error}": draws.median(values(lambda row, e=error: getattr(row, e))) for error in _ERRORS
        },
        "seconds_cpu": draws.median(values(lambda row: row.seconds_cpu), timed),
    }
    return {
        "contender": name,
        "method": rows[0].method,
        "start": rows[0].start,
        "quality": quality,
        "views": views,
        "n": len(rows),
        "n_failed": sum(row.failure is not None for row in rows),
        **with_intervals(figures),
    }


def _medians(entries: Sequence[Entry], dataset: str) -> Grid:
    groups = dict.fromkeys((e["quality"], e["views"]) for e in entries)
    sections = tuple(
        tuple(_median_cells(e) for e in entries if (e["quality"], e["views"]) == group) for group in groups
    )
    caption = (
        f"In brackets {100 * LEVEL:.0f} % bootstrap over objects. A failure has an IoU of 0 and is otherwise infinitely "
        "wrong. Masks are cut out of the depth by the true boxes. The heading of tables is modulo half turns. Processor "
        "seconds are of the estimation alone."
    )
    header = (*("True boxes", "Methods"), "n", "failed", f"IoU>{IOU_LIMIT}", "IoU", *_NAMES, "solve\n(s)")
    return Grid(f"Boxes: medians by how well the true ones are known ({dataset})", header, sections, caption, words=2)  # fmt: skip


def _median_cells(e: Entry) -> tuple[Cell, ...]:
    texts = (
        f"{e['quality']}, {_views(e['views'])}", published.label(e["contender"]), str(e["n"]), str(e["n_failed"]),
        ranged(e, "iou_rate", 1, 2), ranged(e, "median_box_iou", 1, 2),
        *(ranged(e, f"median_{name}", *scale) for name, scale in zip(_ERRORS, _SCALES, strict=True)),
        ranged(e, "seconds_cpu", 1, 1),
    )  # fmt: skip
    return tuple(map(Cell, texts))


def _objects(rows: Sequence[ObjectRow], dataset: str) -> Grid:
    """Every object by itself: there are few."""
    groups = dict.fromkeys((row.case, row.views) for row in rows)
    sections = tuple(
        tuple(_object_cells(row) for row in rows if (row.case, row.views) == group) for group in groups
    )
    header = ("Object", "Methods", "IoU", *_NAMES)
    return Grid(f"Every object's box ({dataset})", header, sections, words=2)


def _object_cells(row: ObjectRow) -> tuple[Cell, ...]:
    what = f"{row.case} ({row.category}, {_quality(row)}), {_views(row.views)}"
    errors = ((getattr(row, name), *scale) for name, scale in zip(_ERRORS, _SCALES, strict=True))
    texts = (what, published.label(row.contender), *(_text(*each) for each in ((row.box_iou, 1, 2), *errors)))
    return tuple(map(Cell, texts))


def _text(value: float | None, factor: float, digits: int) -> str:
    return NONE if value is None else f"{factor * value:.{digits}f}"


def _quality(row: ObjectRow) -> str:
    return row.quality or UNKNOWN


def _views(count: int) -> str:
    return "1 view" if count == 1 else f"{count} views"
