"""An incremental system in which nothing is decoded: a view says that the object is at its camera."""

from types import SimpleNamespace
from typing import Any, cast

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.state import ObjectKeys, ObjectState
from objgraph.graph.builder import ObjectBuilder
from objgraph.slam.incremental import system as module
from objgraph.slam.incremental import upkeep
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.smoother import Smoother
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import Observation, TrackedObject
from tests.toys import TOY_CODE, toy_prior

NOISE = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)


def observation(entry: TrackedObject, camera: int) -> Observation:
    """That the object is at the camera."""
    factor = SimpleNamespace(keys=[entry.keys.pose, camera], camera=camera)
    view = SimpleNamespace(at=lambda pose: None)
    return Observation([cast(Any, factor)], cast(Any, view))


def quadratics(observations: list[Observation], *_: object) -> list[gtsam.BetweenFactorPose3]:
    return [gtsam.BetweenFactorPose3(o.keys[0], o.keys[1], gtsam.Pose3(), NOISE) for o in observations]


def undecoded(monkeypatch: pytest.MonkeyPatch, lag: float | None = None) -> IncrementalSystem:
    """An empty system; observations in it are never stale."""
    monkeypatch.setattr(module, "linearize", quadratics)
    monkeypatch.setattr(upkeep, "linearize", quadratics)
    monkeypatch.setattr(TrackedObject, "departure", lambda *_: 0.0)
    monkeypatch.setattr(TrackedObject, "has_travelled", lambda *_: False)
    config, up = IncrementalConfig(lag=lag), np.array([0.0, 0.0, 1.0])
    system = IncrementalSystem(config, ObjectBuilder(config.graph, up), Smoother(config.lag))
    monkeypatch.setattr(
        system, "observations", lambda entry, placed: [observation(entry, camera) for camera, _ in placed]
    )
    monkeypatch.setattr(system, "solved", lambda entries, cameras, *_: system.estimates(entries, cameras))
    return system


def enter(system: IncrementalSystem, index: int, cameras: list[int]) -> TrackedObject:
    """An object seen from these cameras of the map."""
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


def see(
    system: IncrementalSystem,
    k: int,
    seen: list[TrackedObject],
    factors: list[gtsam.NonlinearFactor] | None = None,
) -> None:
    """The k-th frame, with factors of the caller's."""
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
    observations = [(entry, observation(entry, X(k))) for entry in seen]
    system.add_frame(X(k), str(k), [motion, *(factors or [])], values, observations, at)
