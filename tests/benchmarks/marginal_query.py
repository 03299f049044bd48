"""How long one object's joint marginal takes in a large map: python -m tests.benchmarks.marginal_query 10 100 1000

Crates, each seen by one camera: in an incremental map, where cameras are unknown and all is connected by odometry,
and in a graph with known cameras, of the posterior (that linearises once) and without. Medians over twenty objects, in
milliseconds.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import gtsam
import numpy as np
import torch

from objgraph.bench.speed.crates import CRATE, PERIOD, UP, camera
from objgraph.bench.speed.updates import CONFIG, map_of, solved_crates
from objgraph.graph.handle import ObjectHandle
from objgraph.graph.object_graph import ObjectGraph
from objgraph.priors.fallback import fallback_prior

QUERIES = 20
T = TypeVar("T")


def known_cameras(count: int, solved: Sequence) -> tuple[ObjectGraph, list[ObjectHandle]]:
    """A graph of `count` crates and known cameras, at its solution."""
    prior = fallback_prior(CRATE)
    graph = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), CONFIG.graph, up_world=UP, floor=0.0)
    handles = []
    for i in range(count):
        state, view = solved[i % PERIOD]
        along = i - i % PERIOD
        T = gtsam.Pose3(gtsam.Rot3(), np.array([float(along), 0.0, 0.0]))
        handle = graph.add_object(prior, replace(state, T_world_object=T.compose(state.T_world_object)))
        graph.stand_on_floor(handle)
        graph.observe(handle, view, camera(float(i % PERIOD - PERIOD + along)))
        handles.append(handle)
    graph.refresh()
    return graph, handles


def milliseconds(query: Callable[[T], object], of: Sequence[T]) -> float:
    """Median of one query after the first."""
    some = [of[i] for i in np.linspace(0, len(of) - 1, QUERIES + 1).astype(int)]
    query(some[0])
    spent = []
    for each in some[1:]:
        start = time.perf_counter()
        query(each)
        spent.append(1e3 * (time.perf_counter() - start))
    return float(np.median(spent))


def main(counts: Sequence[int]) -> None:
    torch.set_num_threads(1)
    solved = solved_crates()
    print("objects  incremental, ms  posterior, ms  (made in, s)  graph alone, ms")
    for count in counts:
        growing = map_of(count, solved)
        graph, handles = known_cameras(count, solved)
        incremental = milliseconds(growing.marginals, growing.objects)
        start = time.perf_counter()
        posterior = graph.posterior()
        made = time.perf_counter() - start
        at_once = milliseconds(lambda handle, p=posterior: p.marginals(handle.keys), handles)
        alone = milliseconds(graph.marginals, handles)
        print(f"{count:7} {incremental:16.1f} {at_once:14.1f} {made:13.1f} {alone:16.1f}", flush=True)


if __name__ == "__main__":
    main([int(argument) for argument in sys.argv[1:]] or [10, 100, 1000])
