"""How objects get into the map: never so that the smoother's undamped steps throw it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.errors import NotFiniteError
from factors.reduce import guarded_factor
from factors.state import ObjectKeys, ObjectState
from objgraph.errors import SolveError
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import first_states
from objgraph.graph.solve import Problem
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.mesh import extract_mesh
from objgraph.slam.incremental.alone import Alone
from objgraph.slam.incremental.entrance import VIEWS_ENOUGH, Entrance
from objgraph.slam.incremental.local import polish
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.pending import PendingObject
from objgraph.slam.incremental.tracked import TrackedObject
from objgraph.trust import Trust, judge_estimate
from tests.objgraph.graph.graph_cases import UP, views_of
from tests.objgraph.slam.test_incremental import QUICK, World, distance, mapper, two_chairs
from tests.objgraph.trust.calibrations import calibration
from tests.toys import toy_prior, toy_state

SEEN = 3


@pytest.fixture(scope="module")
def world() -> World:
    return two_chairs()


def cameras_only(world: World, seed: int = 0) -> tuple[IncrementalObjectGraph, list[tuple[int, ObjectView]]]:
    """A map without objects, and what its cameras see of the first chair."""
    objects = mapper()
    for frame in world.frames[:SEEN]:
        objects.update(frame, [])
    views = [observe(frame, 1, QUICK.sampling, seed) for frame in world.frames[:SEEN]]
    return objects, [(X(k), view) for k, view in enumerate(views)]


def displaced(state: ObjectState, metres: float, heading: float, log_scale: float = 0.0) -> ObjectState:
    T = state.T_world_object
    place = T.translation() + np.array([metres, 0.0, 0.0])
    turned = gtsam.Rot3.Rz(heading).compose(T.rotation())
    return replace(state, T_world_object=gtsam.Pose3(turned, place), log_scale=state.log_scale + log_scale)


def chair(name: str = "chair 0") -> TrackedObject:
    return TrackedObject(name, ObjectKeys.numbered(0), toy_prior())


@pytest.mark.parametrize("seed", range(5))
def test_an_object_that_starts_half_a_metre_off_is_found_or_refused(world, seed):
    """Which of them, what is drawn of its views decides."""
    objects, placed = cameras_only(world, seed)
    entry = chair()
    try:
        objects.system.add_object(entry, displaced(world.states[0], 0.5, 0.5), placed)
    except SolveError:
        assert objects.objects == []
        return
    objects.system.commit()
    assert distance(objects.state(entry).T_world_object, world.states[0].T_world_object) < 0.04


FAR = pytest.mark.xfail(
    reason="from three metres, turned about and twice as large, rounding decides: on an Intel Xeon it enters 6 cm off"
)


@pytest.mark.parametrize(
    ("start", "seed"),
    [
        *(((0.15, 0.3), seed) for seed in range(5)),
        ((0.5, 0.5), 7),
        pytest.param((3.0, 3.0, 0.7), 7, marks=FAR),
    ],
)
def test_an_object_that_starts_off_its_place_is_solved_before_it_enters(world, start, seed):
    objects, placed = cameras_only(world, seed)
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

    monkeypatch.setattr(objects.entrance, "merge", fail)
    reports = [objects.update(frame, world.detections(frame)[:1]) for frame in world.frames[1:3]]
    assert [name for report in reports for name in report.entered] == ["chair 0"]
    said = [reason for report in reports for reason in report.reasons]
    assert any("chair 0 is not merged with its neighbours: they do not fit" in reason for reason in said)
    assert not any("does not enter" in reason for reason in said)
    assert len(objects.objects) == 1


@pytest.mark.parametrize("chance", [0.2, 0.5, None])
def test_an_object_in_doubt_waits_for_more_views(world, monkeypatch, chance):
    """Then it enters all the same; one that no calibration knows does not wait."""
    monkeypatch.setattr(Alone, "trust", lambda *_: None if chance is None else Trust(chance, chance))
    objects = mapper()
    reports = [objects.update(frame, world.detections(frame)[:1]) for frame in world.frames[:10]]
    (entered,) = [k for k, report in enumerate(reports) if report.entered]
    said = [reason for report in reports for reason in report.reasons if "waits" in reason]
    if chance == 0.2:
        assert entered == VIEWS_ENOUGH - 1
        assert said == [f"chair 0 waits for {count} views: its pose is right with 20 %" for count in (5, 9)]
    else:
        assert entered < 4
        assert not said


@pytest.mark.parametrize("sightings", range(1, VIEWS_ENOUGH + 1))
def test_an_object_in_doubt_waits_for_five_views_or_nine_however_late_it_was_asked(monkeypatch, sightings):
    monkeypatch.setattr(Alone, "first", lambda _: None)
    monkeypatch.setattr(Alone, "trust", lambda *_: Trust(0.2, 0.2))
    nothing: Any = SimpleNamespace(builder=None, config=QUICK)
    waiting = PendingObject(0, "chair 0", toy_prior(), nothing, 0, sightings=sightings)
    doubt = Entrance(nothing, nothing, ObjectKeys.numbered)._doubt(waiting)
    due = 0 if sightings == VIEWS_ENOUGH else 5 if sightings < 5 else VIEWS_ENOUGH
    assert waiting.awaited == due
    assert (doubt is None) == (due == 0)


def test_a_decoder_that_fails_once_the_frame_is_in_the_map_is_a_reason(world, monkeypatch):
    """Of whatever type its error is: the frame cannot be given again."""

    def fail(*_):
        raise RuntimeError("out of memory")

    objects, said = mapper(), []

    def look(k: int) -> None:
        said.append(objects.update(world.frames[k], world.detections(world.frames[k])[:1]).reasons[-1])

    with monkeypatch.context() as broken:
        broken.setattr(Alone, "rough", fail)
        look(0)
    look(1)
    with monkeypatch.context() as broken:
        broken.setattr(Alone, "first", fail)
        look(2)
    assert said[0] == "chair 0 is not started: out of memory"
    assert said[2] == "chair 0 does not enter: out of memory"
    with monkeypatch.context() as broken:
        broken.setattr(objects.upkeep, "renew", fail)
        (reason,) = objects.update(world.frames[3], []).reasons
    assert reason == "upkeep is left for the next frame: out of memory"
    assert list(objects.cameras) == [X(k) for k in range(4)]


def test_the_doubt_is_the_shipped_calibration_s(monkeypatch):
    prior = replace(toy_prior(), category="chair")
    views = views_of(toy_state(1.0))
    alone = Alone("chair 0", prior, views, ObjectBuilder(QUICK.graph, UP, 0.0), QUICK)
    estimate = alone.first()
    assert alone.trust(estimate) is None  # it knows no such prior
    known = calibration(prior.digest)
    monkeypatch.setattr("objgraph.slam.incremental.alone.shipped_calibration", lambda: known)
    first = first_states(prior, views, alone.builder, QUICK.initialisation)
    task = EstimationTask("chair 0", prior, first.states, tuple(views), UP, 0.0, chances=first.chances)
    surface = estimate.state.to_world(np.asarray(extract_mesh(prior.decoder, estimate.state.code).vertices))
    judged = judge_estimate(task, estimate, surface, known)
    assert judged is not None
    assert alone.trust(estimate) == judged.trust


def test_nothing_is_asked_of_objects_that_no_detection_is_near(world, monkeypatch):
    objects = mapper()
    objects.update(world.frames[0], world.detections(world.frames[0])[:1])
    assert len(objects.pending) == 1

    def fail(*_):
        raise AssertionError("a covariance was asked for")

    monkeypatch.setattr(objects.system.smoother, "covariance", fail)
    objects.update(world.frames[1], [])


def test_what_waits_for_more_views_goes_along_with_the_camera_that_saw_it(world):
    objects = mapper(views_to_enter=9)
    for frame in world.frames[:2]:
        objects.update(frame, world.detections(frame))
    before, move = objects.pose(X(0)), np.array([0.5, 0.0, 0.0])
    fixes = [
        gtsam.PriorFactorPose3(
            key,
            gtsam.Pose3(objects.pose(key).rotation(), objects.pose(key).translation() + move),
            gtsam.noiseModel.Isotropic.Sigma(6, 1e-6),
        )
        for key in objects.cameras
    ]
    objects.update(world.frames[2], world.detections(world.frames[2]), factors=fixes)
    assert np.allclose(objects.pose(X(0)).translation() - before.translation(), move, atol=0.01)
    objects.update(world.frames[3], world.detections(world.frames[3]))
    assert objects.pending == ("chair 0", "chair 1")


@pytest.fixture
def steep() -> Problem:
    """A step whose end is beyond all numbers, and half of which is not."""

    def evaluate(values: gtsam.Values, jacobian: bool):
        at = float(values.atVector(0)[0])
        if at > 0.7:
            raise NotFiniteError("too far")
        return np.array([np.sqrt(1.5 - at)]), [np.array([[-0.5 / np.sqrt(1.5 - at)]])]

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(guarded_factor([0], [1], 1, evaluate, "steep"))
    values.insert(0, np.zeros(1))
    problem = Problem("steep", graph, values, [])
    problem.cost = graph.error(values)
    return problem


def test_a_step_that_is_too_long_is_shortened(steep):
    polish(steep)
    assert 0.3 < float(steep.values.atVector(0)[0]) <= 0.7
    assert steep.cost < 0.75


def test_a_step_that_nothing_determines_is_a_named_error(steep):
    steep.values.insert(1, np.zeros(1))
    steep.graph.push_back(
        gtsam.LinearContainerFactor(
            gtsam.JacobianFactor(1, np.zeros((1, 1)), np.zeros(1), gtsam.noiseModel.Unit.Create(1)),
            steep.values,
        )
    )
    with pytest.raises(SolveError, match="steep"):
        polish(steep)
