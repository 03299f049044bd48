"""How long one object's joint marginal takes in a large map: python -m tests.benchmarks.marginal_query 10 100 1000

Toy chairs, each seen by one camera: in an incremental map, where cameras are unknown and all is connected by odometry,
and in a graph with known cameras, of the posterior (that linearises once) and without. Medians over twenty objects, in
milliseconds.
"""

import sys
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import gtsam
import numpy as np
import torch

from objgraph.graph.object_graph import ObjectGraph, ObjectHandle
from tests.benchmarks.incremental_cost import CONFIG, PERIOD, built, camera, corridor, shifted
from tests.objgraph.slam.test_incremental import UP
from tests.toys import toy_prior

QUERIES = 20
T = TypeVar("T")


def known_cameras(count: int, solved: Sequence) -> tuple[ObjectGraph, list[ObjectHandle]]:
    """A graph of `count` chairs and known cameras, at its solution."""
    prior, graph = (
        toy_prior(),
        ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), CONFIG.graph, up_world=UP, floor=0.0),
    )
    handles = []
    for i in range(count):
        state, view = solved[i % PERIOD]
        along = i - i % PERIOD
        handle = graph.add_object(prior, shifted(state, along))
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
    _, solved = corridor()
    print("objects  incremental, ms  posterior, ms  (made in, s)  graph alone, ms")
    for count in counts:
        growing = built(count, solved)
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
