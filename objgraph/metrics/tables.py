"""Tables of a map's errors for the terminal."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from objgraph.maps.object_map import ObjectMap
from objgraph.metrics.maps import MapErrors
from objgraph.metrics.objects import CHAMFER_LIMIT_M, IOU_LIMIT
from objgraph.show.tables import FALLBACK, NONE


@dataclass(frozen=True)
class Criterion:
    """What counts as a success; those of the paper are `CRITERIA`."""

    label: str
    passes: Callable[[Mapping[str, Any]], bool]


CRITERIA = (
    Criterion("pose", lambda e: e.get("pose_correct") is True),
    Criterion(f"IoU > {IOU_LIMIT}", lambda e: e.get("box_iou") is not None and e["box_iou"] > IOU_LIMIT),
    Criterion(
        f"Chamfer < {100 * CHAMFER_LIMIT_M:.0f} cm",
        lambda e: e.get("chamfer_m") is not None and e["chamfer_m"] < CHAMFER_LIMIT_M,
    ),
)
"""Pose within 20 cm, 20 degrees and 20 % of scale; oriented boxes overlap; surfaces agree."""


def evaluation_table(object_map: ObjectMap, errors: MapErrors) -> Table | None:
    """One row an object with ground truth: errors and which criteria it meets; None without ground truth."""
    if not errors.objects:
        return None
    table = Table(
        title=f"Against ground truth: {escape(object_map.scene)}", caption=evaluation_summary(errors)
    )
    table.add_column("id", justify="right")
    table.add_column("object", no_wrap=True)
    for label in ("translation\n(cm)", "rotation\n(deg)", "scale\n(%)", "box IoU", "Chamfer\n(cm)"):
        table.add_column(label, justify="right", no_wrap=True)
    for criterion in CRITERIA:
        table.add_column(criterion.label.replace(" ", "\n", 1), justify="center", no_wrap=True)
    for entry in object_map.objects:
        if entry.id not in errors.objects:
            continue
        e = errors.objects[entry.id]
        table.add_row(
            str(entry.id),
            escape(entry.category) + FALLBACK * entry.is_fallback,
            _value(e, "translation_m", 100, 1),
            _value(e, "rotation_deg", 1, 1),
            _value(e, "scale_pct", 1, 1),
            _value(e, "box_iou", 1, 2),
            _value(e, "chamfer_m", 100, 1),
            *(_mark(criterion.passes(e)) for criterion in CRITERIA),
        )
    return table


def evaluation_summary(errors: MapErrors) -> str:
    """How many objects with ground truth meet each criterion, failed ones among them, and the median Chamfer."""
    judged = [*errors.objects.values()]
    counts = [f"{c.label}: {sum(map(c.passes, judged))} of {len(judged)}" for c in CRITERIA]
    distances = [e["chamfer_m"] for e in judged if e.get("chamfer_m") is not None]
    if distances:
        counts.append(f"median Chamfer {100 * np.median(distances):.1f} cm ({len(distances)} measured)")
    return ", ".join(counts)


def _value(errors: Mapping[str, Any], key: str, factor: float, digits: int) -> str:
    value = errors.get(key)
    return NONE if value is None else f"{factor * value:.{digits}f}"


def _mark(passed: bool) -> Text:
    return Text("✓", style="green") if passed else Text("✗", style="red")
