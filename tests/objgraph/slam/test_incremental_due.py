"""When an object is solved again as a whole: ever more rarely, whatever the map has forgotten of its views."""

from contextlib import suppress
from types import SimpleNamespace
from typing import Any, cast

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.state import ObjectKeys, ObjectState
from objgraph.errors import SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.slam.incremental import system as module
from objgraph.slam.incremental import upkeep
from objgraph.slam.incremental.alone import Alone
from objgraph.slam.incremental.config import IncrementalConfig, Tolerance
from objgraph.slam.incremental.smoother import Smoother
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import Observation, TrackedObject
from objgraph.slam.incremental.upkeep import Upkeep
from tests.toys import TOY_CODE, toy_prior

FRAMES = 60
NOISE = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)


def observation(entry: TrackedObject, camera: int) -> Observation:
    """That the object is at the camera: nothing is decoded."""
    factor = SimpleNamespace(keys=[entry.keys.pose, camera], camera=camera)
    view = SimpleNamespace(at=lambda pose: None)
    return Observation([cast(Any, factor)], cast(Any, view))


def quadratics(observations: list[Observation], *_: object) -> list[gtsam.BetweenFactorPose3]:
    return [gtsam.BetweenFactorPose3(o.keys[0], o.keys[1], gtsam.Pose3(), NOISE) for o in observations]


@pytest.fixture
def system(request, monkeypatch) -> IncrementalSystem:
    """With a lag of `request.param`; solving an object again fails, which must not make it due again."""

    def fail(*_, **__):
        raise SolveError("not now")

    monkeypatch.setattr(module, "linearize", quadratics)
    monkeypatch.setattr(upkeep, "linearize", quadratics)
    monkeypatch.setattr(Alone, "again_in_all_headings", fail)
    monkeypatch.setattr(Alone, "again", fail)
    monkeypatch.setattr(TrackedObject, "departure", lambda *_: 0.0)
    monkeypatch.setattr(TrackedObject, "has_travelled", lambda *_: False)
    config, up = IncrementalConfig(lag=request.param), np.array([0.0, 0.0, 1.0])
    return IncrementalSystem(config, ObjectBuilder(config.graph, up), Smoother(config.lag))


def enter(system: IncrementalSystem, index: int, cameras: list[int]) -> TrackedObject:
    entry = TrackedObject(f"chair {index}", ObjectKeys.numbered(index), toy_prior())
    at = gtsam.Values()
    ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(TOY_CODE)).insert(at, entry.keys)
    for camera in cameras:
        at.insert(camera, gtsam.Pose3())
    priors = [
        gtsam.PriorFactorVector(key, np.zeros(size), gtsam.noiseModel.Isotropic.Sigma(size, 1.0))
        for key, size in ((entry.keys.log_scale, 3), (entry.keys.code, TOY_CODE))
    ]
    new = [observation(entry, camera) for camera in cameras]
    system.enter(entry, priors, new, cast(Any, quadratics(new)), at)
    return entry


def look(system: IncrementalSystem, k: int, seen: list[TrackedObject]) -> list[str]:
    """A frame's update; the objects that were due."""
    values, at = gtsam.Values(), gtsam.Values()
    values.insert(X(k), gtsam.Pose3())
    at.insert(X(k), gtsam.Pose3())
    for entry in seen:
        system.state(entry).insert(at, entry.keys)
    motion = (
        gtsam.PriorFactorPose3(X(k), gtsam.Pose3(), NOISE)
        if k == 0
        else gtsam.BetweenFactorPose3(X(k - 1), X(k), gtsam.Pose3(), NOISE)
    )
    system.add_frame(
        X(k), str(k), [motion], values, [(entry, observation(entry, X(k))) for entry in seen], at
    )
    due = [entry for entry in seen if entry.is_due]
    for entry in due:
        with suppress(SolveError):
            Upkeep(system).resolve(entry, lambda: ObjectKeys.numbered(99))
    Upkeep(system).renew(seen, Tolerance())
    return [entry.name for entry in due]


@pytest.mark.parametrize("system", [3.0, 7.0, 15.0, None], indirect=True)
def test_an_object_that_is_always_seen_is_solved_again_ever_more_rarely(system):
    for k in range(2):
        look(system, k, [])
    entry = enter(system, 0, [X(0), X(1)])
    due = [k + 1 for k in range(2, FRAMES) if look(system, k, [entry])]
    assert due == [5, 9, 17, 33]


@pytest.mark.parametrize("system", [None], indirect=True)
def test_an_object_that_took_in_a_double_counts_its_views_too(system, monkeypatch):
    """From 6 views to 12: the nine at which it would have been due were never reached."""
    for k in range(2):
        look(system, k, [])
    entries = [enter(system, i, [X(0), X(1)]) for i in range(2)]
    due = [look(system, k, entries) for k in range(2, 6)]
    assert due == [[], [], ["chair 0", "chair 1"], []]
    keep, drop = entries
    monkeypatch.setattr(
        system, "observations", lambda entry, placed: [observation(entry, c) for c, _ in placed]
    )
    monkeypatch.setattr(system, "solved", lambda *_: system.estimates([keep], [X(k) for k in range(6)]))
    system.adopt(keep, drop.placed_views, instead_of=drop)
    assert look(system, 6, [keep]) == ["chair 0"]
    assert look(system, 7, [keep]) == []
