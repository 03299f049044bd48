"""What is written of a comparison on single scans: Table III of the paper, by points and by distance, and a plot."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from objgraph.bench.comparison.boxes.compare import LidarComparison, row_settings
from objgraph.bench.comparison.boxes.rows import DETECTIONS, IOUS, BoxRow, counted, paired, summarize
from objgraph.bench.comparison.writing import published
from objgraph.bench.comparison.writing.bootstrap import LEVEL
from objgraph.bench.comparison.writing.grid import Cell, Grid, ranged, ranked
from objgraph.bench.comparison.writing.report import Entry, Report
from objgraph.errors import EvaluationError
from objgraph.maps.colors import COLORS
from objgraph.show.figure import finish

_FIGURES = ("mean_iou", *IOUS)
_NAMES = ("Mean IoU", "IoU>0.6", "IoU>0.75")
MEASURED = (
    "iou: of oriented boxes, the estimate's about its mesh; mean_iou, iou60, iou75: mean and shares above 0.6 and 0.75 of "
    "the n objects, a failure counts as 0; *_interval: percentile bootstrap over objects; seconds: median of an "
    "object's share of its frame, from points and box to the estimate; by_points: returns in the labelled box; "
    "detections: the detected boxes themselves; paired: mean of a's IoU less b's on the same objects; lengths in metres"
)


def box_report(comparison: LidarComparison, rows: Sequence[BoxRow], least: int) -> Report:
    """Of the objects with `least` returns or more; raises EvaluationError where none is left."""
    chosen, methods = counted(rows, least), comparison.rows_of
    if not chosen:
        failed = next((f"; {row.failure}" for row in rows if row.failure is not None), "")
        raise EvaluationError(
            f"{comparison.root}: no detection is near enough to a label with {least} returns or more; choose other frames "
            f"or --least-points{failed}"
        )
    entries, pairs = (of(chosen, methods, comparison.seed) for of in (summarize, paired))
    found = [row for row in rows if row.method == DETECTIONS]
    return Report(
        comparison.seed,
        chosen,
        entries,
        pairs,
        tables(entries, pairs, least, _noise(comparison)),
        {
            "least_points": least,
            "detections": {
                "all": len(found),
                "of_a_label": sum(row.label is not None for row in found),
                "with_the_points": len(counted(found, least)),
            },
            "settings": {name: row_settings(comparison, name) for name in methods},
        },
        "objects",
        MEASURED,
        {"iou.png": lambda path: iou_plot(chosen, methods, least, path, _noise(comparison))},
    )


def _noise(comparison: LidarComparison) -> str:
    """What a title says of detections that are not as they were."""
    factor = comparison.detector_noise
    return "" if factor == 1.0 else f", {factor:g} times the detections' noise"


def tables(entries: Sequence[Entry], pairs: Sequence[Entry], least: int, noise: str = "") -> list[Grid]:
    """Table III beside the published rows, differences on the same objects, then the first by returns and by distance."""
    ours = [[Cell(published.label(e["method"])), *_cells(e), _seconds(e)] for e in entries]
    theirs = [
        [Cell(f"{published.LABELS[name]} ({published.KITTI_WHERE})", faint=True)]
        + [Cell(f"{x:.3f}", x, faint=True) for x in figures]
        + [Cell("-", faint=True)]
        for name, figures in published.BOXES.items()
    ]
    count = entries[0]["n"] if entries else 0
    caption = (
        f"Objects here: {count}, each with {least} returns or more in its labelled box and a detection within the filter; "
        f"{published.KITTI_WHERE}: {published.KITTI_OBJECTS}. In brackets {100 * LEVEL:.0f} % bootstrap over objects. "
        "Failures count as 0; best bold, second underlined, the published rows among themselves."
    )
    header = ("Methods", *_NAMES, "time (s)")
    sections = tuple(tuple(map(tuple, ranked(rows))) for rows in (ours, theirs))
    whole = Grid(f"Table III: boxes of single scans{noise}", header, sections, caption)
    differences = tuple(
        (Cell(f"{e['a']} - {e['b']}"), Cell(str(e["n"])), Cell(ranged(e, "mean_iou", 1, 3, 2))) for e in pairs
    )
    return [
        whole,
        Grid("Mean difference of IoU on the same objects", ("Methods", "n", "IoU"), (differences,)),
        _parts(entries, "by_points", "returns in the labelled box"),
        _parts(entries, "by_distance_m", "distance (m)"),
    ]


def iou_plot(rows: Sequence[BoxRow], methods: Sequence[str], least: int, path: Path, noise: str = "") -> None:
    """IoU of every object against the returns in its box and against its distance, a colour a method."""
    figure = Figure(figsize=(11, 4.6), dpi=110, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for method, color in zip(methods, COLORS, strict=False):
        chosen = [row for row in rows if row.method == method]
        iou = np.array([row.iou or 0.0 for row in chosen])
        for axis, name in zip(axes, ("points", "distance_m"), strict=True):
            axis.plot(
                [getattr(row, name) for row in chosen], iou, "o", ms=4, alpha=0.8, color=color, label=method
            )
    axes[0].set_xscale("log")
    axes[0].set_xlabel("returns in the labelled box")
    axes[1].set_xlabel("distance (m)")
    axes[0].set_ylabel("IoU of oriented boxes")
    axes[0].set_ylim(0, 1)
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(len(methods), 6)
    )
    figure.suptitle(f"KITTI, objects with {least} returns or more{noise}", fontsize=11)
    finish(figure, None, None, path)


def _parts(entries: Sequence[Entry], name: str, words: str) -> Grid:
    sections = [
        tuple(
            (Cell(f"{_between(part)}, n = {part['n']}"), Cell(published.label(e["method"])), *_cells(part))
            for e in entries
            for part in e[name]
            if part["from"] == start
        )
        for start in sorted({part["from"] for e in entries for part in e[name]})
    ]
    return Grid(f"Table III by {words}", (words.capitalize(), "Methods", *_NAMES), tuple(sections), words=2)


def _between(part: Entry) -> str:
    low = f"{part['from']:.0f}"
    return f"from {low}" if part["to"] is None else f"{low} to {part['to']:.0f}"


def _cells(entry: Entry) -> list[Cell]:
    return [Cell(ranged(entry, name, 1, 3, 2), entry[name]) for name in _FIGURES]


def _seconds(entry: Entry) -> Cell:
    return Cell("-" if entry["seconds"] is None else f"{entry['seconds']:.1f}")
