"""What runs for long holds no more for it, and two graphs in two threads are what they are alone."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gtsam
import numpy as np

from objgraph.datasets.registry import load_scan
from objgraph.graph.object_graph import ObjectGraph
from objgraph.maps.pipeline import MappingConfig, map_scan
from objgraph.observation.sampling import SamplingConfig, observe
from tests.reliability.worlds import ROUND, Books, draw, mapper, resident_kb, rounds, slope
from tests.toys import toy_frame, toy_prior, toy_state

UPDATES = int(os.environ.get("UPDATES", "0"))
_LAG = 10.0
_FEW = 2 * ROUND
"""Of updates in every test run: no memory is judged then."""
_SETTLED = 2000
"""Updates after which memory is judged: before that caches fill."""
_GROWTH_KB = {"update": 1.0, "map": 10.0}
"""Memory that each may take for good."""


def test_a_map_with_a_lag_holds_no_more_after_many_updates(record_property):
    objects, frames = mapper(_LAG), rounds()
    memory, seconds, books = [], [], []
    for k in range(UPDATES or _FEW):
        begun = time.process_time()
        objects.update(*next(frames))
        seconds.append(time.process_time() - begun)
        if k % ROUND == ROUND - 1:
            memory.append(resident_kb())
            books.append(Books.of(objects))
    assert len(objects.objects) == 2
    assert books[-1].others == 0
    # GTSAM uses a slot again once its factor is gone
    assert books[-1].slots <= 2 * books[0].slots
    for name in ("factors", "observations", "variables"):
        assert getattr(books[-1], name) <= getattr(books[0], name), name
    if UPDATES:
        draw(memory, ROUND, "update")
        tenth = max(len(seconds) // 10, 1)
        record_property("updates", UPDATES)
        record_property("kB an update", round(slope(memory, ROUND), 2))
        record_property(
            "s an update, first and last tenth", [np.mean(seconds[:tenth]), np.mean(seconds[-tenth:])]
        )
    if UPDATES >= _SETTLED:
        assert slope(memory, ROUND) < _GROWTH_KB["update"]


def test_many_maps_in_one_process_hold_no_more(given: Path, record_property):
    scan = load_scan("folder", given / "scan")
    config = MappingConfig(views=1, mesh_resolution=16, sampling=SamplingConfig(min_pixels=40))
    memory, first = [], None
    for _ in range(max(UPDATES // 10, 1)):
        (entry,) = map_scan(scan, config).mapped
        first = first or entry
        np.testing.assert_array_equal(entry.vertices, first.vertices)
        memory.append(resident_kb())
    if UPDATES:
        draw(memory, 1, "map")
        record_property("maps", len(memory))
        record_property("kB a map", round(slope(memory, 1), 2))
    if UPDATES >= _SETTLED:
        assert slope(memory, 1) < _GROWTH_KB["map"]


def test_two_graphs_in_two_threads_are_what_they_are_alone():
    alone = [_solved(seed) for seed in (0, 1)]
    with ThreadPoolExecutor(2) as threads:
        together = [*threads.map(_solved, (0, 1))]
    for one, other in zip(alone, together, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    assert not np.array_equal(alone[0][0], alone[1][0])


def _solved(seed: int) -> tuple[np.ndarray, ...]:
    """Pose, scale, code and marginals of a toy chair of this seed."""
    truth = toy_state(0.4 + seed, (0.6, -0.5 + 0.2 * seed, 0.3, 0.2))
    frame = toy_frame([truth], azimuth=0.7 + seed, seed=seed)
    view = observe(frame, 1, SamplingConfig(points=80, hits=50, free=50), seed)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    objects = ObjectGraph(graph, values, up_world=np.array([0.0, 0.0, 1.0]), floor=0.0)
    chair = objects.add_object(toy_prior(), truth)
    objects.observe(chair, view, camera=gtsam.Pose3(frame.T_world_camera))
    objects.optimize()
    state = objects.state(chair)
    return (
        state.T_world_object.matrix(), state.log_scale, state.code, objects.marginals(chair).matrix,
    )  # fmt: skip
