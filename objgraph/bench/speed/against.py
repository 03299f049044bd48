"""The graph beside DSP-SLAM's Gauss-Newton and the paper's gradient descent, on the same objects."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from objgraph.bench.comparison.contenders.methods import GN_SHORT, GRAPH_ENDED
from objgraph.bench.comparison.objects.cases import SyntheticSource
from objgraph.bench.comparison.objects.compare import Comparison, compare
from objgraph.bench.comparison.objects.config import ComparisonConfig
from objgraph.bench.comparison.objects.rows import ObjectRow, contender
from objgraph.bench.comparison.running.store import Tell
from objgraph.bench.speed.figure import Figure, ratio
from objgraph.bench.worlds.cases import BenchmarkConfig
from objgraph.errors import EvaluationError

GRAPH, OURS = "graph", "ours"
_SOONER = (*GRAPH_ENDED, GRAPH)
METHODS = (*_SOONER, GN_SHORT, OURS)


def against_others(out: Path, seed: int, objects: int, tell: Tell | None = None) -> list[Figure]:
    """The graph's time over that of ten of Gauss-Newton's iterations, and that of the paper's 200 over the graph's, starts counted:
    to the end, and until the graph is as good as the other is at its end.

    On as many chairs and tables of the project's families, everyday faults, three views, each method from its own start;
    a method after the other on each object. Raises EvaluationError where none is estimated by all.
    """
    source = SyntheticSource(BenchmarkConfig(seed=seed, objects=objects, difficulty="everyday"))
    methods = tuple(contender(name, "own") for name in METHODS)
    rows = compare(Comparison(source, methods, (3,), out, ComparisonConfig(seed=seed)), tell=tell)
    return figures_of(rows, f"families, everyday, three views, seed {seed}")


def figures_of(rows: Sequence[ObjectRow], of: str) -> list[Figure]:
    """Of the objects that all methods have an estimate of."""
    found: dict[str, dict[str, ObjectRow]] = {}
    for row in rows:
        if row.failure is None:
            found.setdefault(row.case, {})[row.method] = row
    all_of = [each for each in found.values() if each.keys() >= set(METHODS)]
    if not all_of:
        raise EvaluationError("no object was estimated by all methods: their times cannot be compared")
    graph, gn, ours = ([_seconds(each[name]) for each in all_of] for name in (GRAPH, GN_SHORT, OURS))
    off = {
        name: 100 * np.median([_chamfer(each[name]) for each in all_of]) for name in (GRAPH, GN_SHORT, OURS)
    }
    what = (
        f"processor seconds, start counted; {len(all_of)} objects, {of}; {np.median(graph):.1f} s an object; median Chamfer "
        f"{off[GRAPH]:.1f} cm"
    )
    short = f"{what}, Gauss-Newton's {off[GN_SHORT]:.1f} (10 iterations on as many samples)"
    long = f"{what}, that of the paper's 200 iterations {off[OURS]:.1f}"
    as_gn, as_ours = ([_seconds_until(each, name) for each in all_of] for name in (GN_SHORT, OURS))
    until = "until its Chamfer distance is no more than theirs"
    return [
        ratio("graph_over_dsp_gn", graph, gn, 1.0, short),
        ratio("graph_over_dsp_gn_as_good", as_gn, gn, 1.0, f"{until}; {short}"),
        ratio("ours_over_graph", ours, as_ours, 50.0, f"{until}; {long}", better="more"),
        ratio("ours_over_graph_end", ours, graph, None, long, better="more"),
    ]


def _seconds_until(rows: Mapping[str, ObjectRow], other: str) -> float:
    """Of the graph, ended as soon as it is, and stays, as good as the other method; infinite where it is not."""
    seconds, goal = np.inf, _chamfer(rows[other])
    for name in reversed(_SOONER):
        if _chamfer(rows[name]) > goal:
            break
        seconds = _seconds(rows[name])
    return seconds


def _chamfer(row: ObjectRow) -> float:
    return np.inf if row.chamfer_m is None else row.chamfer_m


def _seconds(row: ObjectRow) -> float:
    assert row.seconds_cpu is not None
    return row.seconds_cpu + (row.start_seconds or 0.0)
