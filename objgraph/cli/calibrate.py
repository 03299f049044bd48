"""What the command line does to know how far to trust a map: `objgraph calibrate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from factors import checks
from objgraph.bench.comparison.objects.judged import graph_rows, judged
from objgraph.errors import ConfigError, EvaluationError
from objgraph.trust.calibration import Calibration, load_calibration
from objgraph.trust.fit import fit
from objgraph.version import program_version


@dataclass(frozen=True)
class CalibrateCommand:
    """Learn, from objects whose truth is known, how far a map's poses, shapes and covariances are to be trusted.

    The runs are folders that `objgraph evaluate --methods graph@own` wrote: of your own data, or of the benchmark.
    """

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of `objgraph evaluate`."""
    out: Path
    """File for the calibration, which `objgraph map --calibration` takes."""
    keep: Path | None = None
    """An earlier calibration: what it knows of categories that the runs lack stays."""
    seed: int = 0
    """Of the folds by which held-out figures are made."""

    def __post_init__(self) -> None:
        """Raises ConfigError where the seed is no whole number of at least 0."""
        checks.settings(self, ConfigError)


def run_calibrate(command: CalibrateCommand, console: Console) -> Calibration:
    """Fit, show what it gives on objects that were held out, and write.

    Raises:
        EvaluationError: a folder has no rows that can be used, or of one category several priors'.
        CovarianceError: there are too few objects, the earlier calibration is none, or the file cannot be written.
    """
    if not command.runs:
        raise EvaluationError("name a folder that `objgraph evaluate` wrote")
    earlier = None if command.keep is None else load_calibration(command.keep)
    rows = [row for folder in dict.fromkeys(command.runs) for row in graph_rows(folder)]
    priors: dict[str, str] = {}
    for row in rows:
        if priors.setdefault(row.category, row.prior) != row.prior:
            raise EvaluationError(
                f"the rows of {row.category} are of several priors: calibrate each on its own"
            )
    made = {
        "program": program_version(),
        "rows_by": sorted({row.version for row in rows}),
        "seeds": sorted({row.seed for row in rows}),
        "folds_seed": command.seed,
    }
    calibration = fit(judged(rows), priors, made, command.seed)
    if earlier is not None:
        calibration = calibration.beside(earlier)
    console.print(_table(calibration))
    calibration.save(command.out)
    console.print(
        f"written to {command.out}: `objgraph map --calibration {command.out}` applies it", markup=False
    )
    return calibration


def _table(calibration: Calibration) -> Table:
    table = Table(
        title="Objects held out, by shape",
        caption="sets of boxes: by marginals, with the sides' errors, calibrated",
    )
    for name in (
        "objects of",
        "n",
        "right",
        "Brier",
        "of the rate",
        "sure",
        "of them right",
        "50 %",
        "90 %",
        "95 %",
        "heading 95 %",
        "surface 95 %",
    ):
        table.add_column(name, justify="left" if name == "objects of" else "right")
    for row in calibration.made["held_out"]:
        sets = [
            " ".join(f"{row[f'box{how}_{level}']:.2f}" for how in ("_marginals", "_sides", ""))
            for level in ("50", "90", "95")
        ]
        sure = "-" if row["sure_right"] is None else f"{row['sure_right']:.2f}"
        table.add_row(
            row["of"], str(row["objects"]), f"{row['right']:.2f}", f"{row['brier']:.3f}", f"{row['brier_base']:.3f}",
            str(row["sure"]), sure, *sets, f"{row['heading_95']:.2f}", f"{row['surface_95']:.2f}",
        )  # fmt: skip
    return table
