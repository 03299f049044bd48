"""What an update of the incremental map costs as the map grows: python -m tests.benchmarks.incremental_cost

A corridor of toy chairs, a metre apart; a camera goes along it and every chair enters from its true state, so that no time is
spent on guesses. Then the camera sees the last chairs again, and the updates are timed: all of each, and the part
that is the smoother's (the rest is pictures' sampling, association and the decoder). Only the chairs near the
camera are drawn.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import torch

from factors.state import ObjectKeys, ObjectState
from objgraph.incremental.object_graph import IncrementalObjectGraph
from objgraph.incremental.tracked import TrackedObject
from objgraph.observation import Frame, Instance
from objgraph.sampling import observe
from objgraph.single_object import single_object
from objgraph.solve import solve
from tests.objgraph.test_incremental import QUICK, UP, chair_at
from tests.toys import look_at, toy_picture, toy_prior

SEEN = 10
"""Updates that are timed."""


def camera(x: float) -> gtsam.Pose3:
    return gtsam.Pose3(look_at(np.array([x, -2.2, 1.2]), np.array([x, 0.0, 0.4])))


def picture(chairs: list[ObjectState], x: float, seed: int) -> tuple[Frame, list[int]]:
    """What is seen from x along the corridor, and the numbers of the chairs in it."""
    near = [i for i in range(len(chairs)) if abs(i - x) < 1.6]
    frame = toy_picture([chairs[i] for i in near], camera(x).matrix(), f"{x:.2f}", seed=seed, floor=2000.0)
    return frame, near


class Stopwatch:
    """Adds up the time that calls of some methods take."""

    def __init__(self, owner: object, names: tuple[str, ...]) -> None:
        self.seconds = 0.0
        for name in names:
            setattr(owner, name, self._timed(getattr(owner, name)))

    def _timed(self, method: Callable) -> Callable:
        def call(*args, **kwargs):
            start = time.perf_counter()
            try:
                return method(*args, **kwargs)
            finally:
                self.seconds += time.perf_counter() - start

        return call


def corridor(count: int) -> tuple[list[tuple[float, float]], int]:
    """Seconds of each timed update and of its smoother, and how many objects the map has."""
    rng, prior = np.random.default_rng(0), toy_prior()
    chairs = [chair_at(float(i), 0.0, rng.uniform(-3, 3), 0.4 * rng.normal(size=4)) for i in range(count)]
    objects = IncrementalObjectGraph(UP, floor=0.0, config=QUICK, find_prior=lambda _: prior)
    for i, state in enumerate(chairs):
        frame, near = picture(chairs, float(i), i)
        report = objects.update(frame, [])
        view = observe(frame, 1 + near.index(i), QUICK.sampling)
        entry = TrackedObject(f"chair {i}", ObjectKeys.numbered(i), prior)
        placed = view.at(objects.pose(report.camera))
        single = single_object(prior, state, [placed], UP, 0.0, QUICK.graph)
        solve([single.problem], QUICK.start)
        objects.system.add_object(entry, single.state, [(report.camera, view)])
        objects._note_centres([entry])
    smoother = Stopwatch(
        objects.system.smoother, ("update", "marginal_factors", "covariance", "pose", "vector")
    )
    seconds = []
    for k in range(SEEN):
        frame, near = picture(chairs, count - 1.5 - 0.02 * k, 10_000 + k)
        detections = [Instance(1 + j, "chair") for j in range(len(near))]
        smoother.seconds, start = 0.0, time.perf_counter()
        report = objects.update(replace(frame, name=f"again {k}"), detections)
        if "-v" in sys.argv:
            print(report.pending, report.entered, report.reasons)
        if not report.entered and not report.pending:
            seconds.append((time.perf_counter() - start, smoother.seconds))
    return seconds, len(objects.objects)


def main(counts: list[int]) -> None:
    torch.set_num_threads(1)
    print("objects  updates  median, ms  of it the smoother, ms")
    for count in counts:
        seconds, found = corridor(count)
        update, smoother = 1e3 * np.median(np.array(seconds), axis=0)
        print(f"{found:7d} {len(seconds):8d} {update:11.0f} {smoother:23.1f}", flush=True)


if __name__ == "__main__":
    main([int(w) for w in sys.argv[1:] if w != "-v"] or [10, 100, 1000])
