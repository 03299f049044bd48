"""Objects in a smoother that the caller owns: it is read, and told what to add and what to take out."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.slam.incremental.own_smoother import ObjectFrontEnd, Step
from objgraph.slam.odometry import OdometryNoise
from tests.objgraph.slam.test_incremental import QUICK, UP, World, distance, mapper, nearest, two_chairs
from tests.toys import toy_prior

FIRST = 100
"""The caller's cameras have numbers of his own."""
BODY_T_CAMERA = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.6, 0.1, -1.5), np.array([0.2, -0.1, 0.4]))


@pytest.fixture(scope="module")
def world() -> World:
    return two_chairs()


def isam2() -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = 1
    return gtsam.ISAM2(params)


class Caller:
    """A pose graph with odometry and a landmark of its own, and the objects in it."""

    def __init__(self, smoother, body_T_camera: gtsam.Pose3 | None = None, lag: float | None = None) -> None:
        prior = toy_prior()
        self.smoother, self.lag = smoother, lag
        self.off = gtsam.Pose3() if body_T_camera is None else body_T_camera.inverse()
        self.objects = ObjectFrontEnd(
            smoother, UP, floor=0.0, config=QUICK, find_prior=lambda _: prior, body_T_camera=body_T_camera,
            object_keys=lambda n: ObjectKeys.numbered(50 + n),
        )  # fmt: skip
        self.steps: list[Step] = []

    def run(self, world: World, frames: int | None = None) -> "Caller":
        before = None
        for k, frame in enumerate(world.frames[:frames]):
            body, key = gtsam.Pose3(frame.T_world_camera).compose(self.off), X(FIRST + k)
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            if before is None:
                tight = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
                graph.push_back(gtsam.PriorFactorPose3(key, body, tight))
                graph.push_back(
                    gtsam.PriorFactorPoint3(L(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1.0))
                )
                values.insert(key, body)
                values.insert(L(0), np.ones(3))
            else:
                motion = before.between(body)
                graph.push_back(
                    gtsam.BetweenFactorPose3(X(FIRST + k - 1), key, motion, OdometryNoise().model(motion))
                )
                values.insert(key, self.pose(k - 1).compose(motion))
            before = body
            self.update(graph, values, [], (), k)
            step = self.objects.step(frame, world.detections(frame), camera=key)
            slots = self.update(step.factors, step.values, step.remove, step.alive, k)
            self.objects.accept(slots)
            self.steps.append(step)
        return self

    def update(self, graph, values, remove, alive, time: int) -> list[int]:
        if self.lag is None:
            result = self.smoother.update(graph, values, remove)
            return list(result.getNewFactorsIndices())
        times = dict.fromkeys([*values.keys(), *alive, L(0)], float(time))
        self.smoother.update(graph, values, times, remove)
        return list(self.smoother.getISAM2Result().getNewFactorsIndices())

    @property
    def isam(self) -> gtsam.ISAM2:
        return self.smoother if isinstance(self.smoother, gtsam.ISAM2) else self.smoother.getISAM2()

    def pose(self, k: int) -> gtsam.Pose3:
        return self.isam.calculateEstimatePose3(X(FIRST + k))


def object_poses(caller: Caller) -> list[gtsam.Pose3]:
    return [caller.isam.calculateEstimatePose3(entry.keys.pose) for entry in caller.objects.objects]


@pytest.mark.parametrize("body", [None, BODY_T_CAMERA], ids=["camera", "on a body"])
def test_objects_enter_the_caller_s_smoother_where_they_stand_and_hold_his_cameras(world, body):
    caller = Caller(isam2(), body).run(world)
    assert len(caller.objects.objects) == len(world.states)
    for state in world.states:
        assert min(distance(T, state.T_world_object) for T in object_poses(caller)) < 0.06
    drift = [
        distance(gtsam.Pose3(f.T_world_camera), T) for f, T in zip(world.frames, world.truth, strict=True)
    ]
    off = caller.off.inverse()
    left = [distance(caller.pose(k).compose(off), T) for k, T in enumerate(world.truth)]
    assert left[-1] < 0.6 * drift[-1]
    np.testing.assert_allclose(caller.isam.calculateEstimatePoint3(L(0)), 0.0, atol=1e-6)
    assert {key for step in caller.steps for key in list(step.values.keys())} == {
        key for entry in caller.objects.objects for key in entry.keys
    }
    for entry in caller.objects.objects:
        state = caller.objects.state(entry)
        assert state.T_world_object.equals(caller.isam.calculateEstimatePose3(entry.keys.pose), 1e-9)
        assert len(caller.objects.views(entry)) == len(entry.placed_views)
        assert np.linalg.eigvalsh(caller.objects.marginals(entry).matrix).min() > 0
    assert caller.objects.builder.floor == 0.0
    assert any(step.remove for step in caller.steps)  # stale quadratics are replaced, not added to
    views = sum(len(entry.placed_views) for entry in caller.objects.objects)
    graph = caller.isam.getFactorsUnsafe()
    held = [i for i in range(graph.size()) if graph.exists(i)]
    keys = {entry.keys.pose for entry in caller.objects.objects}
    on_both = [i for i in held if keys & set(graph.at(i).keys()) and len(list(graph.at(i).keys())) == 4]
    assert len(on_both) == views


def test_a_step_changes_nothing_of_the_caller_s(world):
    caller = Caller(isam2()).run(world, frames=5)
    before, size = caller.isam.calculateEstimate(), caller.isam.getFactorsUnsafe().size()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    body, motion = caller.pose(4), gtsam.Pose3()
    graph.push_back(
        gtsam.BetweenFactorPose3(X(FIRST + 4), X(FIRST + 5), motion, OdometryNoise().model(motion))
    )
    values.insert(X(FIRST + 5), body)
    caller.update(graph, values, [], (), 5)
    size = caller.isam.getFactorsUnsafe().size()
    before = caller.isam.calculateEstimate()
    frame = world.frames[4]
    step = caller.objects.step(frame, world.detections(frame), camera=X(FIRST + 5))
    assert step.factors.size() > 0
    assert caller.isam.getFactorsUnsafe().size() == size
    assert caller.isam.calculateEstimate().equals(before, 0.0)
    with pytest.raises(SolveError, match="no slots yet"):
        caller.objects.step(frame, [], camera=X(FIRST + 5))
    with pytest.raises(SolveError, match=rf"1 slots for {step.factors.size()} factors"):
        caller.objects.accept([0])


def test_a_camera_that_is_not_in_the_smoother_is_named(world):
    caller = Caller(isam2())
    with pytest.raises(SolveError, match="x7: not in your smoother"):
        caller.objects.step(world.frames[0], [], camera=X(7))


def test_a_fixed_lag_keeps_the_objects(world):
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = 1
    params.findUnusedFactorSlots = True
    caller = Caller(gtsam.IncrementalFixedLagSmoother(4.0, params), lag=4.0).run(world)
    assert not caller.isam.valueExists(X(FIRST))
    assert len(caller.objects.objects) == len(world.states)
    for state in world.states:
        assert min(distance(T, state.T_world_object) for T in object_poses(caller)) < 0.08


def test_a_map_of_its_own_takes_camera_keys_and_bodies_too(world):
    prior = toy_prior()
    plain = mapper()
    objects = type(plain)(
        UP, floor=0.0, config=QUICK, find_prior=lambda _: prior, body_T_camera=BODY_T_CAMERA
    )
    for k, frame in enumerate(world.frames):
        report = objects.update(frame, world.detections(frame), camera=X(FIRST + k))
        assert report.camera == X(FIRST + k)
    assert list(objects.cameras) == [X(FIRST + k) for k in range(len(world.frames))]
    assert len(objects.objects) == len(world.states)
    for state in world.states:
        assert nearest(objects, state)[1] < 0.06
    last = objects.pose(X(FIRST + len(world.frames) - 1)).compose(BODY_T_CAMERA)
    assert distance(last, world.truth[-1]) < 0.1
    with pytest.raises(SolveError, match=r"x100 is in the map already"):
        objects.update(replace(world.frames[0], name="again"), [], camera=X(FIRST))
