"""The graph beside DSP-SLAM's Gauss-Newton and the paper's gradient descent, on the same objects."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objgraph.bench.comparison.contenders.methods import GN_SHORT
from objgraph.bench.comparison.objects.cases import SyntheticSource
from objgraph.bench.comparison.objects.compare import Comparison, compare
from objgraph.bench.comparison.objects.config import ComparisonConfig
from objgraph.bench.comparison.objects.rows import ObjectRow, contender
from objgraph.bench.comparison.running.store import Tell
from objgraph.bench.speed.figure import Figure, ratio
from objgraph.bench.worlds.cases import BenchmarkConfig
from objgraph.errors import EvaluationError

METHODS = ("graph", GN_SHORT, "ours")


def against_others(out: Path, seed: int, objects: int, tell: Tell | None = None) -> list[Figure]:
    """The graph's time over Gauss-Newton's, and that of the paper's 200 iterations over the graph's, starts counted.

    On as many chairs and tables of the project's families, everyday faults, three views, each method from its own start;
    a method after the other on each object. Raises EvaluationError where none is estimated by all.
    """
    source = SyntheticSource(BenchmarkConfig(seed=seed, objects=objects, difficulty="everyday"))
    methods = tuple(contender(name, "own") for name in METHODS)
    rows = compare(Comparison(source, methods, (3,), out, ComparisonConfig(seed=seed)), tell=tell)
    return figures_of(rows, f"families, everyday, three views, seed {seed}")


def figures_of(rows: Sequence[ObjectRow], of: str) -> list[Figure]:
    """Of the objects that all methods have an estimate of."""
    found: dict[str, dict[str, ObjectRow]] = {name: {} for name in METHODS}
    for row in rows:
        if row.failure is None:
            found[row.method][row.case] = row
    both = [case for case in found[METHODS[0]] if all(case in each for each in found.values())]
    if not both:
        raise EvaluationError("no object was estimated by all methods: their times cannot be compared")
    graph, gn, ours = ([_seconds(found[name][case]) for case in both] for name in METHODS)
    off = [np.median([_chamfer(found[name][case]) for case in both]) for name in METHODS]
    what = (
        f"processor seconds, start counted; {len(both)} objects, {of}; {np.median(graph):.1f} s an object; median Chamfer "
        f"{100 * off[0]:.1f} cm"
    )
    short = f"{what}, Gauss-Newton's {100 * off[1]:.1f} (10 iterations on as many samples)"
    long = f"{what}, that of the paper's 200 iterations {100 * off[2]:.1f}"
    return [
        ratio("graph_over_dsp_gn", graph, gn, 1.0, short),
        ratio("ours_over_graph", ours, graph, 50.0, long, better="more"),
    ]


def _chamfer(row: ObjectRow) -> float:
    return np.inf if row.chamfer_m is None else row.chamfer_m


def _seconds(row: ObjectRow) -> float:
    assert row.seconds_cpu is not None
    return row.seconds_cpu + (row.start_seconds or 0.0)
