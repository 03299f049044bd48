"""What an update of the incremental map costs as the map grows: python -m tests.benchmarks.incremental_cost

A corridor of toy chairs, a metre apart; a camera goes along it, and at the end it sees the last chairs again and again: those
updates, `IncrementalObjectGraph.update` whole, are timed. The corridor repeats itself every ten chairs, so that maps of
any size (in tens) end alike, and a chair's picture and its own solution are made once: the map is built from these,
since it is not building that is measured. The parts of an update do not contain each other:

- association: of detections to objects, without the smoother's covariances;
- local: the camera and what it sees are solved with the decoder, against the map's marginal;
- smoother: everything that is asked of ISAM2;
- upkeep: observations linearised anew, without the smoother's part;
- rest: points and rays are drawn from the images.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import torch

from factors.state import ObjectKeys, ObjectState
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import solve
from objgraph.observation.frames import Frame, Instance
from objgraph.observation.sampling import ObjectView, observe
from objgraph.slam.incremental import front_end
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.tracked import TrackedObject, linearize
from objgraph.slam.odometry import OdometryNoise
from tests.objgraph.slam.test_incremental import QUICK, UP, chair_at
from tests.toys import look_at, toy_picture, toy_prior

SEEN = 10
"""Updates that are timed."""
PERIOD = 10
"""Metres, and chairs, after which the corridor repeats itself."""
CONFIG = replace(QUICK, odometry=OdometryNoise(translation=0.002, rotation=2e-4))
"""Odometry that after a kilometre still knows where it is."""


class Clock:
    """Seconds by parts; what one part spends in another is the other's."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner: list[float] = []

    def watch(self, part: str, owner: object, *names: str) -> None:
        """Count all further calls of these functions of `owner` as `part`."""
        for name in names:
            setattr(owner, name, self.timed(part, getattr(owner, name)))

    def timed(self, part: str, function: Callable) -> Callable:
        def call(*args, **kwargs):
            self._inner.append(0.0)
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.process_time() - start
                self.seconds[part] = self.seconds.get(part, 0.0) + spent - self._inner.pop()
                if self._inner:
                    self._inner[-1] += spent

        return call


PARTS = ("association", "local", "smoother", "upkeep", "rest")


@dataclass
class Corridor:
    """Chairs at x = ..., -2, -1 and what is seen of them; x = 0 is where it ends, whatever its length."""

    chairs: list[ObjectState]
    """Of one period, that before x = 0."""

    def at(self, x: int) -> ObjectState:
        """The chair that stands at x."""
        return shifted(self.chairs[x % PERIOD], x - x % PERIOD + PERIOD)

    def picture(self, x: float, seed: int) -> tuple[Frame, list[int]]:
        """What is seen from x, and where the chairs in it stand."""
        near = [i for i in range(-PERIOD - 2, 0) if abs(i - x) < 1.6]
        chairs = [self.at(i) for i in near]
        return toy_picture(chairs, camera(x).matrix(), f"{x:.2f}", seed=seed, floor=2000.0), near


def shifted(state: ObjectState, x: float) -> ObjectState:
    T = state.T_world_object
    return replace(state, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + np.array([x, 0.0, 0.0])))


def camera(x: float) -> gtsam.Pose3:
    return gtsam.Pose3(look_at(np.array([x, -2.2, 1.2]), np.array([x, 0.0, 0.4])))


def corridor() -> tuple[Corridor, list[tuple[ObjectState, ObjectView]]]:
    """The corridor, and for each chair of a period its own solution from the one view of it, at the map's start."""
    rng, prior = np.random.default_rng(0), toy_prior()
    chairs = [
        chair_at(float(i - PERIOD), 0.0, rng.uniform(-3, 3), 0.4 * rng.normal(size=4)) for i in range(PERIOD)
    ]
    whole, solved = Corridor(chairs), []
    for i in range(-PERIOD, 0):
        frame, near = whole.picture(float(i), i + PERIOD)
        view = observe(frame, 1 + near.index(i), CONFIG.sampling)
        single = ObjectBuilder(CONFIG.graph, UP, 0.0).alone(prior, whole.at(i), [view])
        solve([single], CONFIG.start)
        solved.append((single.state, view))
    return whole, solved


def built(count: int, solved: list[tuple[ObjectState, ObjectView]]) -> IncrementalObjectGraph:
    """A map of `count` chairs, each seen by the camera that passed it."""
    prior = toy_prior()
    objects = IncrementalObjectGraph(UP, floor=0.0, config=CONFIG, find_prior=lambda _: prior)
    system = objects.system
    nothing = toy_picture([], np.eye(4))
    models: dict[int, list[gtsam.LinearContainerFactor]] = {}
    for i in range(-count, 0):
        report = objects.update(replace(nothing, name=str(i), T_world_camera=camera(float(i)).matrix()), [])
        state, view = solved[i % PERIOD]
        T_camera_object = camera(float(i % PERIOD - PERIOD)).between(state.T_world_object)
        here = replace(state, T_world_object=objects.pose(report.camera).compose(T_camera_object))
        entry = TrackedObject(f"chair {i}", ObjectKeys.numbered(count + i), prior)
        at = system.estimates([], [report.camera])
        here.insert(at, entry.keys)
        placed = [(report.camera, view)]
        own = [*system.observations(entry, placed), *system.unseen(entry)]
        if i % PERIOD not in models:
            models[i % PERIOD] = linearize(own, at, system.slope)
        quadratics = [
            with_keys(quadratic, o.keys, at) for o, quadratic in zip(own, models[i % PERIOD], strict=True)
        ]
        priors = ObjectBuilder(CONFIG.graph, UP).priors(prior, entry.keys)
        system.enter(entry, priors, own, quadratics, at)
        objects._note_centres([entry])
    return objects


def with_keys(
    quadratic: gtsam.LinearContainerFactor, keys: list[int], at: gtsam.Values
) -> gtsam.LinearContainerFactor:
    """The same quadratic on other variables, about where those are."""
    other = quadratic.rekey(gtsam.KeyVector(keys))
    assert isinstance(other, gtsam.LinearContainerFactor)
    return gtsam.LinearContainerFactor(other.factor(), at.extract(gtsam.KeyVector(keys)))


def updates(objects: IncrementalObjectGraph, whole: Corridor) -> list[dict[str, float]]:
    """Seconds of each update's parts, and of all together, while the camera sees the last chairs again."""
    clock, system, spent = Clock(), objects.system, []
    clock.watch(
        "smoother", system.smoother, "update", "marginal_factors", "covariance", "pose", "vector", "has"
    )
    clock.watch("local", system, "solved")
    clock.watch("upkeep", objects, "keep_current")
    update, associate = clock.timed("rest", objects.update), front_end.associate
    clock.watch("association", front_end, "associate")
    try:
        for k in range(SEEN):
            frame, near = whole.picture(-1.5 - 0.02 * k, 10_000 + k)
            clock.seconds.clear()
            report = update(
                replace(frame, name=f"again {k}"), [Instance(1 + j, "chair") for j in range(len(near))]
            )
            if "-v" in sys.argv:
                print(report.seen, report.pending, report.reasons)
            if not report.entered and not report.pending:
                spent.append({**clock.seconds, "update": sum(clock.seconds.values())})
    finally:
        front_end.associate = associate
    return spent


def main(counts: list[int]) -> None:
    torch.set_num_threads(1)
    whole, solved = corridor()
    print("objects  built, s  updates  median, ms" + "".join(f"{part:>13}" for part in PARTS))
    for count in counts:
        start = time.process_time()
        objects = built(count, solved)
        seconds = time.process_time() - start
        spent = updates(objects, whole)
        medians = [1e3 * np.median([each.get(part, 0.0) for each in spent]) for part in ("update", *PARTS)]
        row = f"{medians[0]:12.0f}" + "".join(f"{median:13.1f}" for median in medians[1:])
        print(f"{len(objects.objects):7d} {seconds:9.0f} {len(spent):8d}{row}", flush=True)


if __name__ == "__main__":
    main([int(w) for w in sys.argv[1:] if w != "-v"] or [10, 100, 1000])
