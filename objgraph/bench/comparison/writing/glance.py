"""A suite at a glance: what comes out where each method is run as its users would, a line a comparison and category."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from objgraph.bench.comparison.writing.grid import NONE, Cell, Grid, ranked_across

METHODS = ("graph", "ours", "dsp-slam", "node-slam", "dsp-slam-gn", "dsp-slam-gn-released")
_OBJECTS = ("9-DoF poses right, median Chamfer distance (cm)", "pose_rate", "median_chamfer_m")
_BOXES = ("Boxes: IoU", "median_box_iou", None)
_CARS = ("Cars: mean IoU of boxes", "mean_iou", None)
_CAPTION = "At the most views; each method begins by itself where it was run so. Failures count as wrong, and infinitely. Bold is best, underlined second; intervals are on the parts' pages."


def glance_tables(documents: Mapping[str, Mapping[str, Any]]) -> list[Grid]:
    """By the comparisons' titles: of each, at the most views, the methods that begin by themselves or, where there are no such,
    as they were run. A comparison without a graph, or of it alone, is left out."""
    found = [_table(documents, *figures) for figures in (_OBJECTS, _BOXES, _CARS)]
    *others, last = [grid for grid in found if grid.sections[0]] or [found[0]]
    return [*others, replace(last, caption=_CAPTION)]


def _table(documents: Mapping[str, Mapping[str, Any]], title: str, rate: str, median: str | None) -> Grid:
    lines = []
    for name, document in documents.items():
        rows = [row for row in document["rows"] if row.get(rate) is not None]
        most = max((row.get("views") or 0 for row in rows), default=0)
        rows = [row for row in rows if (row.get("views") or 0) == most]
        groups = dict.fromkeys((row.get("category"), row.get("quality")) for row in rows)
        for group in groups:
            own = [row for row in rows if (row.get("category"), row.get("quality")) == group]
            by_method = {method: _as_run(own, method) for method in METHODS}
            given = [row for row in by_method.values() if row is not None]
            if by_method[METHODS[0]] is None or len(given) < 2:
                continue
            what = ", ".join([name, *(str(word) for word in group if word is not None)])
            cells = [_cell(row, rate, median) for row in by_method.values()]
            lines.append((Cell(what), Cell(str(given[0].get("n", NONE))), *ranked_across(cells)))
    return Grid(title, ("Where", "objects", *METHODS), (tuple(lines),))


def _as_run(rows: Sequence[Mapping[str, Any]], method: str) -> Mapping[str, Any] | None:
    names = {row.get("contender") or row.get("method"): row for row in rows}
    return names.get(f"{method}@own", names.get(method))


def _cell(row: Mapping[str, Any] | None, rate: str, median: str | None) -> Cell:
    if row is None:
        return Cell(NONE)
    text = f"{row[rate]:.2f}"
    if median is not None:
        text += f", {100 * row[median]:.1f}" if row.get(median) is not None else ", ∞"
    return Cell(text, row[rate])
