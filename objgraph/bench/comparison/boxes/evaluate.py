"""What the command line does with methods on single LiDAR scans: `objgraph evaluate --dataset kitti`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from objgraph.bench.comparison.boxes.compare import LidarComparison, compare_boxes
from objgraph.bench.comparison.boxes.report import document, iou_plot, tables
from objgraph.bench.comparison.boxes.rows import counted, paired, summarize
from objgraph.bench.comparison.document import markdown
from objgraph.bench.comparison.rows import write_text
from objgraph.errors import EvaluationError
from objgraph.training.mesh_folder import write_json
from objgraph.version import program_version

KITTI = "kitti"
"""The data set's name."""


def run_box_comparison(
    comparison: LidarComparison,
    least_points: int,
    jobs: int,
    retry_failed: bool,
    json: Path,
    console: Console,
    line: str,
    tell: Callable[[str, int, int], None],
) -> dict[str, Any]:
    """Compare, then write and show what came out; `line` is the command as it was typed.

    Raises:
        EvaluationError: see `compare_boxes`; or no detected object is left to be counted.
        DatasetError: the data cannot be read.
    """
    found = compare_boxes(comparison, jobs, retry_failed, program_version(), tell)
    rows = counted(found, least_points)
    if not rows:
        failed = next((f"; {row.failure}" for row in found if row.failure is not None), "")
        raise EvaluationError(
            f"{comparison.root}: no detection is near enough to a label with {least_points} returns or more; choose "
            f"other frames or --least-points{failed}"
        )
    entries = summarize(rows, comparison.rows_of, comparison.seed)
    pairs = paired(rows, comparison.rows_of, comparison.seed)
    result = document(comparison, rows, entries, pairs, least_points, line)
    write_json(result, json)
    grids = tables(entries, pairs, least_points)
    write_text(markdown(grids, line, comparison.seed), comparison.out / "tables.md")
    iou_plot(rows, comparison.rows_of, least_points, comparison.out / "iou.png")
    for grid in grids:
        console.print(grid.rich())
    console.print(f"figures in {json}, tables, rows and plot in {comparison.out}", soft_wrap=True)
    return result
