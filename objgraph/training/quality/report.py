"""What an evaluation of a prior found: the JSON document and the table on the terminal."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.guess.train import GuessQuality
from objgraph.training.meshes.folder import ChosenMeshes
from objgraph.training.quality.evaluate import PriorEvaluationConfig, ShapeRow
from objgraph.training.quality.random_codes import RandomCodes

MEASURED = (
    "canonical frame, unit box diagonal; chamfer: mean of the two directed mean point-to-surface distances; "
    "recall, precision: shares within 0.02; iou: signs at grid nodes; floaters count; a failure has infinite "
    "chamfer (null), IoU 0 and recall 0; partial: one noiseless depth view, pose and scale known"
)
"""What the numbers mean, for whoever reads the JSON alone."""


def document(
    prior: ShapePrior,
    prior_file: str,
    meshes: ChosenMeshes,
    rows: Sequence[ShapeRow],
    config: PriorEvaluationConfig,
    random_codes: RandomCodes | None = None,
    guess: Mapping[int, GuessQuality] | None = None,
) -> dict[str, Any]:
    """The evaluation as JSON: medians over all meshes, failures included, then a row for each; infinity is null.

    `guess` is what the first guess is worth, by the number of views; the headings' figures are those of most views.
    """
    result: dict[str, Any] = {
        "category": prior.category,
        **summary(rows),
        "prior": {"file": prior_file, "sha256": prior.card.get("sha256")},
        "meshes": {"folders": [str(folder) for folder in meshes.folders], "chosen": meshes.chosen},
        "measured": MEASURED,
        "seed": config.seed,
        "settings": asdict(config),
    }
    if random_codes is not None:
        result["random_codes"] = asdict(random_codes)
        result |= {"one_piece": random_codes.one_piece, "fills_box": random_codes.fills_box}
    if guess:
        result["first_guess"] = {
            str(views): {
                **each.as_json(),
                "probability": each.probability.tolist(),
                "wanted": each.wanted.tolist(),
            }
            for views, each in guess.items()
        }
        most = guess[max(guess)]
        result |= {"heading_right": most.heading_right, "heading_nll": most.heading_nll}
    result["rows"] = [asdict(row) for row in rows]
    return result


def summary(rows: Sequence[ShapeRow]) -> dict[str, float | int | None]:
    """Medians; None where half of the meshes or more have no value."""
    full, partial = _median(row.chamfer for row in rows), _median(row.chamfer_partial for row in rows)
    return {
        "n": len(rows),
        "failed": sum(row.error is not None for row in rows),
        "median_chamfer": full,
        "median_iou": _median(row.iou for row in rows),
        "median_recall": _median(row.recall for row in rows),
        "median_precision": _median(row.precision for row in rows),
        "median_chamfer_points": _median(row.chamfer_points for row in rows),
        "median_chamfer_partial": partial,
        "median_iou_partial": _median(row.iou_partial for row in rows),
        "median_recall_partial": _median(row.recall_partial for row in rows),
        "median_partial_ratio": _median(row.partial_ratio for row in rows),
        "ratio_of_medians": partial / full if partial is not None and full else None,
    }


def table(rows: Sequence[ShapeRow], title: str) -> Table:
    """One line a mesh, worst last, and the medians."""
    columns = ("chamfer", "IoU", "recall", "precision", "from one view: chamfer", "IoU", "recall", "ratio")
    result = Table(title=escape(title), show_footer=True)
    medians = summary(rows)
    result.add_column("mesh", f"median of {medians['n']}, {medians['failed']} failed", overflow="fold")
    keys = ("chamfer", "iou", "recall", "precision", "chamfer_partial", "iou_partial", "recall_partial")
    digits = (4, 2, 3, 3, 4, 2, 3, 2)
    for name, key, places in zip(columns, (*keys, "partial_ratio"), digits, strict=True):
        result.add_column(name, _number(medians[f"median_{key}"], places), justify="right")
    for row in sorted(rows, key=lambda row: math.inf if row.chamfer is None else row.chamfer):
        values = (getattr(row, key) for key in (*keys, "partial_ratio"))
        numbers = (_number(value, places) for value, places in zip(values, digits, strict=True))
        result.add_row(escape(row.mesh), *numbers, style="red" if row.error else None)
    return result


def _median(values: Any) -> float | None:
    """The median where None is infinitely bad."""
    median = float(np.median([math.inf if value is None else value for value in values]))
    return median if math.isfinite(median) else None


def _number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"
