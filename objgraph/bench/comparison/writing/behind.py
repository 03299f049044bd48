"""Where the graph is behind: every figure of a comparison at which another method is better."""

import math
from collections.abc import Mapping
from typing import Any

from objgraph.bench.comparison.writing.against import GRAPH, against
from objgraph.bench.comparison.writing.grid import Cell, Grid

_FIGURES = (
    ("pose_rate", "9-DoF pose", 1.0, 3, 1),
    ("iou_rate", "IoU>0.25", 1.0, 3, 1),
    ("chamfer_rate", "CD<0.2", 1.0, 3, 1),
    ("median_translation_m", "translation (cm)", 100.0, 1, -1),
    ("median_rotation_deg", "rotation (deg)", 1.0, 1, -1),
    ("median_chamfer_m", "Chamfer (cm)", 100.0, 2, -1),
    ("median_box_iou", "IoU", 1.0, 2, 1),
    ("median_heading_error_deg", "heading (deg)", 1.0, 1, -1),
    ("median_scale_pct", "size (%)", 1.0, 1, -1),
    ("median_scale_pct_max", "worst edge (%)", 1.0, 1, -1),
    ("mean_iou", "mean IoU", 1.0, 3, 1),
    ("iou60", "IoU>0.6", 1.0, 3, 1),
    ("iou75", "IoU>0.75", 1.0, 3, 1),
)
"""Name in the JSON, in words, factor, digits, and 1 where more is better."""

FIGURES_OF_ROWS: dict[str, Any] = {
    **dict.fromkeys(("contender", "method", "category", "quality"), str | None),
    **dict.fromkeys(("views", "n"), int | None),
    **{name: float | None for name, *_ in _FIGURES},
    **{f"{name}_interval": list[Any] | None for name, *_ in _FIGURES},
}
"""What is read of a comparison's rows."""


def behind_table(documents: Mapping[str, Mapping[str, Any]]) -> Grid:
    """By the comparisons' titles: a row for the best of those that are better than the graph of `against`, as printed."""
    rows = []
    for title, document in documents.items():
        names = list(dict.fromkeys(map(_name, document["rows"])))
        pairs = [(a, b) for a, b in against(names) if a.partition("@")[0] == GRAPH != b.partition("@")[0]]
        for own in document["rows"]:
            of = {key: own.get(key) for key in ("category", "views", "quality")}
            beaten = {b for a, b in pairs if a == _name(own)}
            others = [
                e
                for e in document["rows"]
                if _name(e) in beaten and all(e.get(key) == value for key, value in of.items())
            ]
            for figure, words, factor, digits, better in _FIGURES:
                known = [(value, e) for e in others if (value := _value(e, figure)) is not None]
                if (mine := _value(own, figure)) is None or not known:
                    continue
                found, best = max(known, key=lambda pair: better * pair[0])
                theirs, ours = (round(factor * value, digits) for value in (found, mine))
                if better * (theirs - ours) > 0:
                    what = ", ".join(
                        [title, *(_words(key, value) for key, value in of.items() if value is not None)]
                    )
                    own_text = "∞" if math.isinf(ours) else ours
                    texts = (what, words, _name(best), theirs, _name(own), own_text, own.get("n") or "-")
                    rows.append(tuple(Cell(str(text)) for text in texts))
    header = ("Where", "Figure", "Best", "its", "Graph", "its", "objects")
    caption = "Every rate and median, of all parts of this page, at which some method is better than the graph that begins where it does."
    return Grid("Where the graph is behind", header, (tuple(rows),), caption, words=3)


def _value(entry: Mapping[str, Any], figure: str) -> float | None:
    """A figure, infinite where it is not there and its interval is, as JSON has it; None where there is neither."""
    value = entry.get(figure)
    return math.inf if value is None and entry.get(f"{figure}_interval") is not None else value


def _name(entry: Mapping[str, Any]) -> str:
    return entry.get("contender") or entry.get("method") or ""


def _words(key: str, value: Any) -> str:
    return f"{value} view{'s' * (value > 1)}" if key == "views" else str(value)
