"""Every method on objects with a true shape: which rows are wanted, and the jobs that make those that are missing."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np

from objgraph.bench.comparison.contenders.methods import method
from objgraph.bench.comparison.objects.cases import Case, CaseSource
from objgraph.bench.comparison.objects.config import ComparisonConfig, row_settings
from objgraph.bench.comparison.objects.measure import Job
from objgraph.bench.comparison.objects.rows import SHARED, Key, ObjectRow, csv_text, method_and_start
from objgraph.bench.comparison.running.store import Tell, complete, digest, write_text
from objgraph.errors import EvaluationError
from objgraph.work import HERE, Workers

log = logging.getLogger(__name__)

ROWS = "objects.jsonl"
CSV = "objects.csv"


@dataclass(frozen=True)
class Comparison:
    """What is compared on what."""

    source: CaseSource
    methods: tuple[str, ...]
    """By name, or with their starts (`rows.contender`)."""
    views: tuple[int, ...]
    out: Path
    """Folder of the rows."""
    config: ComparisonConfig = field(default_factory=ComparisonConfig)


def compare(
    comparison: Comparison,
    workers: Workers = HERE,
    retry_failed: bool = False,
    version: str = "",
    tell: Tell | None = None,
) -> list[ObjectRow]:
    """A row for every method, object and number of views, in that order of nesting; also written to `out`.

    Rows are appended to `objects.jsonl` as they are done, and one that is there already is not made again (with
    `retry_failed`, a failed one is); at the end `objects.csv` holds the rows of this comparison.

    Raises:
        EvaluationError: an unknown method; a folder that cannot be written, is in use, or holds rows of the same
            methods made with other settings or weights; a process that died.
        DatasetError: there is nothing to compare on.
    """
    tell = tell or (lambda what, done, total: None)
    for name in comparison.methods:
        method(method_and_start(name)[0])
    cases = comparison.source.cases(lambda done, total: tell("reading scans", done, total))
    _check_cases(cases)
    settings = {
        (name, category): row_settings(comparison.source, comparison.config, name, category)
        for name, category in product(comparison.methods, dict.fromkeys(case.category for case in cases))
    }
    wanted = [
        (name, case.id, views) for name, case, views in product(comparison.methods, cases, comparison.views)
    ]

    def jobs(missing: Sequence[Key]) -> list[Job]:
        left: dict[tuple[str, int], list[str]] = {}
        for name, case, views in missing:
            left.setdefault((case, views), []).append(name)
        digests = {group: digest(each) for group, each in settings.items()}
        return [
            Job(
                case, comparison.source.dataset, views,
                {name: digests[name, case.category] for name in left[case.id, views]}, comparison.config, version,
            )
            for case, views in product(cases, comparison.views)
            if (case.id, views) in left
        ]  # fmt: skip

    rows = complete(comparison.out / ROWS, ObjectRow, wanted, settings, jobs, workers, retry_failed, tell)
    write_text(csv_text(rows), comparison.out / CSV)
    if apart := starts_apart(rows):
        log.warning(
            "methods did not start alike on %d of the objects and views: versions %s made the rows of %s; give another "
            "folder to compare them fairly",
            len(apart), "; ".join(sorted({row.version for row in rows})), comparison.out,
        )  # fmt: skip
    return rows


def starts_apart(rows: Sequence[ObjectRow], tolerance: float = 1e-4) -> list[tuple[str, int]]:
    """Objects and numbers of views on which methods began at different states, as other versions may find them."""
    starts: dict[tuple[str, int], list[np.ndarray]] = {}
    for row in rows:
        if row.start == SHARED and row.start_T_world_object is not None and row.start_scale is not None:
            start = np.vstack([np.array(row.start_T_world_object)[:3].T, row.start_scale])
            starts.setdefault((row.case, row.views), []).append(start)
    return [key for key, found in starts.items() if np.ptp(np.stack(found), axis=0).max() > tolerance]


def _check_cases(cases: Sequence[Case]) -> None:
    if not cases:
        raise EvaluationError("no object is left to compare on: choose other categories or scans")
    ids = [case.id for case in cases]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise EvaluationError(f"two objects are called {twice}; name every scan once")
