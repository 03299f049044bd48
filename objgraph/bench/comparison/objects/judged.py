"""Rows of the graph's estimates as a calibration takes them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objgraph.bench.comparison.objects.compare import ROWS
from objgraph.bench.comparison.objects.rows import OWN, ObjectRow
from objgraph.bench.comparison.running.store import RowFile
from objgraph.covariance.quantile import squared_limit
from objgraph.errors import EvaluationError
from objgraph.trust.calibration import LEVELS
from objgraph.trust.evidence import Evidence
from objgraph.trust.fitted import Judged

METHOD = "graph"
SHAPE_M = 0.03
"""Chamfer distance below which a shape is called right."""
_LEAST_SIGMA = 1e-4
"""Metres."""


def graph_rows(folder: Path) -> list[ObjectRow]:
    """The rows of the graph from its own start in a folder of `objgraph evaluate`, without failures; of each the last.

    Raises:
        EvaluationError: there are none, or an earlier program made them, which kept no evidence.
    """
    path = folder / ROWS
    if not path.is_file():
        raise EvaluationError(f"{path}: no such file; give a folder that `objgraph evaluate` wrote")
    with RowFile(path, ObjectRow) as file:
        latest = {row.key: row for row in file.rows if (row.method, row.start) == (METHOD, OWN)}
    rows = [row for row in latest.values() if row.failure is None and row.chamfer_m is not None]
    if not rows:
        raise EvaluationError(
            f"{path}: no rows of the graph from its own start on true shapes; "
            "run `objgraph evaluate --methods graph@own` there"
        )
    if any(row.evidence is None or row.box_modes is None for row in rows):
        raise EvaluationError(
            f"{path}: rows of an earlier program, without evidence; evaluate again into another folder"
        )
    return rows


def judged(rows: Sequence[ObjectRow]) -> list[Judged]:
    """What a calibration is fitted to."""
    return [
        Judged(
            row.category,
            row.shape,
            " ".join(
                word for word in (row.dataset, row.difficulty, row.shapes, f"{row.views} views") if word
            ),
            Evidence(**(row.evidence or {})),
            row.pose_correct,
            row.chamfer_m is not None and row.chamfer_m < SHAPE_M,
            [(mode[0], np.array(mode[1:])) for mode in row.box_modes or ()],
            np.array(row.box_covariance),
            np.array(row.box_extents),
            np.array(row.box_seen),
            _surface(row),
        )
        for row in rows
    ]


def _surface(row: ObjectRow) -> dict[str, float]:
    assert row.surface_error is not None
    assert row.surface_sigma is not None
    squared = np.square(np.array(row.surface_error) / np.maximum(np.array(row.surface_sigma), _LEAST_SIGMA))
    levels = {word: float(word) / 100 for word in LEVELS}
    return {
        word: float(np.quantile(squared, level) / squared_limit(level, 1)) for word, level in levels.items()
    }
