"""How objects get into the map: never so that the smoother's undamped steps throw it."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.state import ObjectKeys, ObjectState
from objgraph.errors import SolveError
from objgraph.observation.sampling import ObjectView, observe
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.tracked import TrackedObject
from tests.objgraph.slam.test_incremental import QUICK, World, distance, mapper, two_chairs
from tests.toys import toy_prior

SEEN = 3


@pytest.fixture(scope="module")
def world() -> World:
    return two_chairs()


def cameras_only(world: World) -> tuple[IncrementalObjectGraph, list[tuple[int, ObjectView]]]:
    """A map without objects, and what its cameras see of the first chair."""
    objects = mapper()
    for frame in world.frames[:SEEN]:
        objects.update(frame, [])
    views = [observe(frame, 1, QUICK.sampling) for frame in world.frames[:SEEN]]
    return objects, [(X(k), view) for k, view in enumerate(views)]


def displaced(state: ObjectState, metres: float, heading: float, log_scale: float = 0.0) -> ObjectState:
    T = state.T_world_object
    place = T.translation() + np.array([metres, 0.0, 0.0])
    turned = gtsam.Rot3.Rz(heading).compose(T.rotation())
    return replace(state, T_world_object=gtsam.Pose3(turned, place), log_scale=state.log_scale + log_scale)


def chair(name: str = "chair 0") -> TrackedObject:
    return TrackedObject(name, ObjectKeys.numbered(0), toy_prior())


@pytest.mark.parametrize("start", [(0.15, 0.3), (0.5, 0.5), (3.0, 3.0, 0.7)])
def test_an_object_that_starts_off_its_place_is_solved_before_it_enters(world, start):
    objects, placed = cameras_only(world)
    entry = chair()
    objects.system.add_object(entry, displaced(world.states[0], *start), placed)
    objects.system.commit()
    assert distance(objects.state(entry).T_world_object, world.states[0].T_world_object) < 0.04
    for k in range(SEEN):
        assert distance(objects.pose(X(k)), world.truth[k]) < 0.08


@pytest.mark.parametrize("start", [(0.5, 2.0, -0.5), (1.0, 2.0, 0.4), (1.0, 3.0, 0.5)])
def test_an_object_too_far_off_is_refused_and_the_map_stays(world, start):
    objects, placed = cameras_only(world)
    before = objects.estimate()
    with pytest.raises(SolveError, match=r"chair 7: .*start it nearer to its place"):
        objects.system.add_object(chair("chair 7"), displaced(world.states[0], *start), placed)
    assert objects.objects == []
    assert objects.estimate().equals(before, 0.0)


def test_an_object_that_entered_but_cannot_be_merged_has_entered(world, monkeypatch):
    objects = mapper()
    objects.update(world.frames[0], world.detections(world.frames[0])[:1])

    def fail(*_):
        raise SolveError("they do not fit")

    monkeypatch.setattr(objects, "_merge", fail)
    reports = [objects.update(frame, world.detections(frame)[:1]) for frame in world.frames[1:3]]
    assert [name for report in reports for name in report.entered] == ["chair 0"]
    said = [reason for report in reports for reason in report.reasons]
    assert any("chair 0 is not merged with its neighbours: they do not fit" in reason for reason in said)
    assert not any("does not enter" in reason for reason in said)
    assert len(objects.objects) == 1


def test_nothing_is_asked_of_objects_that_no_detection_is_near(world, monkeypatch):
    objects = mapper()
    objects.update(world.frames[0], world.detections(world.frames[0])[:1])
    assert len(objects.pending) == 1

    def fail(*_):
        raise AssertionError("a covariance was asked for")

    monkeypatch.setattr(objects.system.smoother, "covariance", fail)
    objects.update(world.frames[1], [])
