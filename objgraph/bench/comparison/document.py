"""What is written of a comparison: one JSON document, tables in Markdown, pictures."""

from collections.abc import Mapping, Sequence
from typing import Any

from objgraph.bench.comparison.bootstrap import LEVEL, RESAMPLES
from objgraph.bench.comparison.compare import Comparison, starts_apart
from objgraph.bench.comparison.config import prior_hash, row_settings
from objgraph.bench.comparison.grid import Grid
from objgraph.bench.comparison.measure import WELL_RECONSTRUCTED
from objgraph.bench.comparison.rows import ObjectRow
from objgraph.bench.comparison.summary import WORST
from objgraph.version import program_version

MEASURED = (
    "metres, degrees, seconds; rates: shares of all objects, failures among them; medians: a failure is infinite, null "
    "where that comes out; pearson: of |SDF| and its standard deviation sqrt(J S J^T) over points of the true surface, "
    "mean over well-reconstructed objects (n_well); seconds: median of the estimation alone, seconds_cpu in processor time; *_interval: percentile "
    "bootstrap over distinct shapes, an infinite end null; paired: error of a less error of b on the same objects; "
    "starts_apart: objects and views on which the methods did not begin at the same state, which should be none"
)
"""What the numbers mean, for whoever reads the JSON alone."""


def document(
    comparison: Comparison,
    rows: Sequence[ObjectRow],
    entries: Sequence[Mapping[str, Any]],
    pairs: Sequence[Mapping[str, Any]],
    command: str,
) -> dict[str, Any]:
    """Figures and all that made them; no date, so that equal runs give equal documents but for the times."""
    categories = dict.fromkeys(row.category for row in rows)
    settings = {
        name: row_settings(comparison.source, comparison.config, name, next(iter(categories)))
        for name in comparison.methods
    }
    first = next(iter(settings.values()))
    return {
        "command": command,
        "version": program_version(),
        "rows_made_by": sorted({row.version for row in rows}),
        "starts_apart": len(starts_apart(rows)),
        "seed": comparison.config.seed,
        "data": first["data"],
        "config": first["common"],
        "methods": {name: each["method"] for name, each in settings.items()},
        "priors": {category: prior_hash(category, comparison.config) for category in categories},
        "objects": {
            category: len({r.case for r in rows if r.category == category}) for category in categories
        },
        "shapes": {
            category: len({r.shape for r in rows if r.category == category}) for category in categories
        },
        "well_reconstructed": WELL_RECONSTRUCTED,
        "bootstrap": {"over": "distinct shapes", "level": LEVEL, "resamples": RESAMPLES},
        "worst": WORST,
        "measured": MEASURED,
        "rows": list(entries),
        "paired": list(pairs),
    }


def markdown(tables: Sequence[Grid], command: str, seed: int) -> str:
    """All tables, and what made them."""
    head = f"Made by `{command}` (seed {seed}, version {program_version()}).\n"
    return "\n".join([head, *(table.markdown() for table in tables)])
