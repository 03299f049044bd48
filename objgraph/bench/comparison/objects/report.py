"""What is reported of objects with a true shape: how far estimates are right, or how far covariances hold."""

from collections.abc import Sequence
from typing import Any

from objgraph.bench.comparison.objects import calibration
from objgraph.bench.comparison.objects.cases import SYNTHETIC
from objgraph.bench.comparison.objects.compare import ROWS, Comparison, starts_apart
from objgraph.bench.comparison.objects.config import prior_hash, row_settings
from objgraph.bench.comparison.objects.measure import WELL_RECONSTRUCTED
from objgraph.bench.comparison.objects.plots import (
    error_plot,
    faults_plot,
    reliability_plot,
    uncertainty_plot,
)
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.objects.stability import MEASURED as OF_STABILITY
from objgraph.bench.comparison.objects.stability import stability
from objgraph.bench.comparison.objects.summary import WORST, paired, summarize
from objgraph.bench.comparison.objects.tables import all_tables, calibration_tables, stability_table
from objgraph.bench.comparison.writing.report import Report
from objgraph.errors import EvaluationError
from objgraph.trust.calibration import Calibration

MEASURED = (
    "metres, degrees, seconds; rates: shares of all objects, failures among them; medians: a failure is infinite, null "
    "where that comes out; pearson: of |SDF| and its standard deviation sqrt(J S J^T) over points of the true surface, "
    "mean over well-reconstructed objects (n_well), pearson_binned: of the standard deviation and the mean |SDF| in 100 bins of it; seconds: median of the estimation alone, seconds_cpu in processor time, start_seconds of finding its start; *_interval: percentile "
    "bootstrap over distinct shapes, an infinite end null; paired: error of a less error of b on the same objects; "
    "starts_apart: objects and views on which the methods did not begin at the same state, which should be none"
)
_SHAPES = "distinct shapes"


def object_report(
    comparison: Comparison, rows: Sequence[ObjectRow], again: Sequence[Sequence[ObjectRow]] = ()
) -> Report:
    """The paper's Tables I and II, medians and differences; error against views, and against uncertainty at the most."""
    methods, seed, data = comparison.methods, comparison.config.seed, _data(comparison)
    entries, pairs = summarize(rows, methods, seed), paired(rows, methods, seed)
    steady = stability(again) if again else []
    tables = all_tables(entries, pairs, methods, data) + ([stability_table(steady, data)] if steady else [])
    details = _details(comparison, rows) | ({"stability": steady} if steady else {})
    most = max(comparison.views)
    chosen = [row for row in rows if row.views == most]
    words = f"{data}, {most} view{'s' * (most > 1)}"
    return Report(
        seed, rows, entries, pairs, tables, details, _SHAPES, "; ".join([MEASURED, *([OF_STABILITY] if steady else [])]),
        {
            "error_against_views.png": lambda path: error_plot(entries, methods, data, path),
            "error_against_uncertainty.png": lambda path: uncertainty_plot(chosen, methods, words, path),
            "pose_over_faults.png": lambda path: faults_plot(chosen, methods, words, path),
        },
    )  # fmt: skip


def calibration_report(
    comparison: Comparison, rows: Sequence[ObjectRow], known: Calibration | None = None
) -> Report:
    """What the covariances of the rows are worth, and what a calibration makes of them; raises EvaluationError where there
    are none."""
    seed, data = comparison.config.seed, _data(comparison)
    judged, methods = calibration.with_fused(rows, comparison.methods)
    entries = calibration.calibration(judged, methods, seed, known)
    if not entries:
        raise EvaluationError(
            f"none of {', '.join(comparison.methods)} gives a covariance in {comparison.out / ROWS} that could be judged: "
            "add graph or ours, or give a fresh --out"
        )
    return Report(
        seed, judged, entries, [], calibration_tables(entries, data), _details(comparison, judged), _SHAPES, calibration.MEASURED,
        {"reliability.png": lambda path: reliability_plot(judged, methods, data, path)},
        "calibration.md",
    )  # fmt: skip


def _data(comparison: Comparison) -> str:
    dataset = comparison.source.dataset
    if dataset != SYNTHETIC:
        return dataset
    settings = comparison.source.settings()
    return f"{dataset}, {settings['difficulty']}, {settings['shapes']}, seed {comparison.config.seed}"


def _details(comparison: Comparison, rows: Sequence[ObjectRow]) -> dict[str, Any]:
    categories = dict.fromkeys(row.category for row in rows)
    settings = {
        name: row_settings(comparison.source, comparison.config, name, next(iter(categories)))
        for name in comparison.methods
    }
    first = next(iter(settings.values()))

    def count(name: str) -> dict[str, int]:
        return {
            category: len({getattr(row, name) for row in rows if row.category == category})
            for category in categories
        }

    return {
        "starts_apart": len(starts_apart(rows)),
        "data": first["data"],
        "config": first["common"],
        "methods": {name: each["method"] for name, each in settings.items()},
        "priors": {category: prior_hash(category, comparison.config) for category in categories},
        "objects": count("case"),
        "shapes": count("shape"),
        "well_reconstructed": WELL_RECONSTRUCTED,
        "worst": WORST,
    }
