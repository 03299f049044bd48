"""Frame by frame: toy chairs seen by a camera whose odometry drifts."""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from factors.depth import RaySampling
from factors.state import ObjectState
from objgraph.errors import ObservationError, SolveError
from objgraph.graph.builder import GraphConfig
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, minimize
from objgraph.observation.frames import Frame, Instance
from objgraph.observation.sampling import SamplingConfig
from objgraph.slam.incremental import upkeep
from objgraph.slam.incremental.config import IncrementalConfig, Tolerance
from objgraph.slam.incremental.front_end import FrameReport
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.tracked import TrackedObject, cameras_of
from objgraph.slam.odometry import OdometryNoise, dead_reckoning, drifting_motions
from objgraph.trust.judge import judge
from tests.objgraph.trust.calibrations import calibration
from tests.toys import look_at, toy_picture, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
QUICK = IncrementalConfig(
    graph=GraphConfig(sampling=RaySampling(coarse=10, cells=8)),
    sampling=SamplingConfig(points=80, hits=50, free=50),
    initialisation=InitialisationConfig(headings=4, guesses=4, points=80, rays=80, shortlist=2, keep=1),
)
FRAMES = 12


@dataclass
class World:
    """Chairs, where the camera really was, and what it saw under poses that drift."""

    states: list[ObjectState]
    truth: list[gtsam.Pose3]
    frames: list[Frame]

    def detections(self, frame: Frame) -> list[Instance]:
        pixels = {i: np.count_nonzero(frame.instances == i) for i in range(1, len(self.states) + 1)}
        return [Instance(i, "chair") for i, count in pixels.items() if count > 400]


def chair_at(x: float, y: float, heading: float, code) -> ObjectState:
    state = toy_state(heading, code)
    T = state.T_world_object
    return replace(state, T_world_object=gtsam.Pose3(T.rotation(), np.array([x, y, T.translation()[2]])))


def walk(states: list[ObjectState], frames: int, seed: int = 0) -> World:
    """One round about the chairs, with the odometry's noise."""
    rng = np.random.default_rng(seed)
    bearings = np.linspace(0.3, 0.3 + 1.6 * np.pi, frames)
    truth = [
        gtsam.Pose3(look_at(np.array([2.6 * np.cos(b), 2.6 * np.sin(b), 1.3]), [0, 0, 0.4])) for b in bearings
    ]
    odometry, pictures = dead_reckoning(truth[0], drifting_motions(truth, OdometryNoise(), rng)), []
    for k, (pose, drifted) in enumerate(zip(truth, odometry, strict=True)):
        picture = toy_picture(states, pose.matrix(), str(k), seed=k)
        pictures.append(replace(picture, T_world_camera=drifted.matrix()))
    return World(states, truth, pictures)


def two_chairs(frames: int = FRAMES) -> World:
    states = [
        chair_at(-0.6, 0.0, 0.4, (0.6, -0.5, 0.3, 0.2)),
        chair_at(0.6, 0.2, 2.2, (-0.4, 0.5, -0.3, 0.1)),
    ]
    return walk(states, frames)


def mapper(rounded: bool = False, **changes) -> IncrementalObjectGraph:
    prior = toy_prior(rounded)
    return IncrementalObjectGraph(UP, floor=0.0, config=replace(QUICK, **changes), find_prior=lambda _: prior)


def mapped(
    world: World, rounded: bool = False, **changes
) -> tuple[IncrementalObjectGraph, list[FrameReport]]:
    objects = mapper(rounded, **changes)
    return objects, [objects.update(frame, world.detections(frame)) for frame in world.frames]


@pytest.fixture(scope="module")
def world() -> World:
    return two_chairs()


@pytest.fixture(scope="module")
def run(world) -> tuple[IncrementalObjectGraph, list[FrameReport]]:
    return mapped(world)


def distance(a: gtsam.Pose3, b: gtsam.Pose3) -> float:
    return float(np.linalg.norm(a.translation() - b.translation()))


def nearest(objects: IncrementalObjectGraph, state: ObjectState) -> tuple[TrackedObject, float]:
    found = [(distance(objects.state(o).T_world_object, state.T_world_object), o) for o in objects.objects]
    far, entry = min(found, key=lambda each: each[0])
    return entry, far


def test_each_chair_is_in_the_map_once_and_where_it_stands(world, run):
    objects, reports = run
    assert len(objects.objects) == len(world.states)
    assert objects.pending == ()
    for state in world.states:
        _, far = nearest(objects, state)
        assert far < 0.05
    names = {entry.name for entry in objects.objects}
    assert {name for report in reports for name in report.entered} == names
    assert set(reports[-1].seen) == names
    assert [report.camera for report in reports] == [X(k) for k in range(FRAMES)]
    assert [report.frame for report in reports] == list(objects.cameras.values())
    assert all(report.reasons for report in reports)


def test_an_object_is_judged_from_where_its_cameras_are_now(world, run):
    """By the smoother and, the same, by the batch graph: the smoother's cameras, not the odometry's."""
    objects, _ = run
    batch = objects.batch()
    batch.refresh()
    for entry, handle in zip(objects.objects, batch.objects, strict=True):
        views = objects.views(entry)
        assert [view.frame for view in views] == [view.frame for view in batch.views(handle)]
        assert len(views) == entry.views
        for view in views:
            assert distance(view.T_world_camera, world.truth[int(view.frame)]) < 0.06
        of_map, of_batch = (
            judge(*pair, calibration=calibration("toy")) for pair in ((objects, entry), (batch, handle))
        )
        assert of_map is not None
        assert of_batch is not None
        assert of_map.trust.evidence["off"] < 0.2
        assert of_batch.trust.evidence == pytest.approx(of_map.trust.evidence, abs=0.05)
        T_world_box = of_map.box.T_world_box
        assert min(distance(T_world_box, state.T_world_object) for state in world.states) < 0.05


def test_cameras_are_held_by_the_objects(world, run):
    objects, _ = run
    drift = [
        distance(gtsam.Pose3(f.T_world_camera), T) for f, T in zip(world.frames, world.truth, strict=True)
    ]
    left = [distance(objects.pose(X(k)), T) for k, T in enumerate(world.truth)]
    assert max(left[2:]) < 0.06
    assert np.sqrt(np.mean(np.square(left))) < np.sqrt(np.mean(np.square(drift))) / 3


def test_the_map_is_the_optimum_of_its_batch_graph(run):
    """Levenberg-Marquardt on all factors at once, frozen where the map is, moves no object by a standard deviation."""
    objects, _ = run
    batch = objects.batch()
    assert batch.graph.size() > 2 * FRAMES * 2
    batch.refresh()
    factors = [factor for handle in batch.objects for factor in handle.factors]
    problem = Problem("batch", batch.graph, gtsam.Values(batch.values), factors)
    minimize(problem, LevenbergMarquardtConfig(iterations=25, relative_tolerance=1e-7))
    for entry in objects.objects:
        covariance = objects.marginals(entry)
        here, there = objects.state(entry), ObjectState.from_values(problem.values, entry.keys)
        step = np.concatenate(
            [
                here.T_world_object.localCoordinates(there.T_world_object),
                there.log_scale - here.log_scale,
                there.code - here.code,
            ]
        )
        assert np.sqrt(np.mean(np.square(step / covariance.sigma))) < 0.5
        own = batch.marginals(next(h for h in batch.objects if h.name == entry.name))
        np.testing.assert_allclose(covariance.sigma, own.sigma, rtol=0.25)


def test_joint_marginals_hold_the_cameras(run):
    objects, _ = run
    entry = objects.objects[0]
    joint = objects.joint_marginals(entry, [X(5)])
    assert joint.shape == (13 + 6, 13 + 6)
    np.testing.assert_allclose(joint[:13, :13], objects.marginals(entry).matrix, rtol=1e-6, atol=1e-9)
    assert np.linalg.eigvalsh(joint).min() > 0
    assert np.abs(joint[:6, 13:]).max() > 1e-8


def test_what_has_moved_is_linearised_anew(run):
    objects, _ = run
    system, entry = objects.system, objects.objects[0]
    strict, before = Tolerance(1e-12, 1e-12, 1e-12, 1e-12), [o.number for o in entry.observations]
    here = system.estimates([entry], [o.camera for o in entry.observations if o.camera is not None])
    assert objects.upkeep.renew([entry], strict, limit=3) == 3
    renewed = [o for o, number in zip(entry.observations, before, strict=True) if o.number != number]
    assert len(renewed) == 3
    assert all(system.smoother.holds(o.number) for o in entry.observations)
    assert sum(system.smoother.holds(number) for number in before) == len(before) - 3
    for observation in renewed:
        assert observation.point.equals(here.extract(gtsam.KeyVector(observation.keys)), 1e-9)
    assert objects.upkeep.renew([entry], Tolerance(10, 10, 10, 10)) == 0


def test_what_has_only_travelled_is_told_from_what_has_moved(run):
    objects, _ = run
    system, entry = objects.system, objects.objects[0]
    observation = entry.observations[0]
    values = system.estimates([entry], [observation.camera])
    assert entry.departure(observation, observation.point, objects.config.tolerance) < 1e-9
    moved = gtsam.Values(values)
    moved.update(entry.keys.pose, values.atPose3(entry.keys.pose).retract(np.r_[0, 0, 0, 0.02, 0, 0]))
    assert entry.departure(observation, moved, objects.config.tolerance) > 1
    together = gtsam.Values(observation.point)
    shift = gtsam.Pose3(gtsam.Rot3.Rz(1.0), np.array([2.0, 0, 0]))
    for key in (entry.keys.pose, observation.camera):
        together.update(key, shift.compose(observation.point.atPose3(key)))
    assert entry.departure(observation, together, objects.config.tolerance) < 1e-6
    assert entry.has_travelled(observation, together)


def test_what_a_closed_loop_took_along_is_not_decoded_again(world, monkeypatch):
    objects = mapper()
    for frame in world.frames[:6]:
        objects.update(frame, world.detections(frame))
    system, entry = objects.system, objects.objects[0]
    shift = gtsam.Pose3(gtsam.Rot3.Rz(0.8), np.array([2.0, -1.0, 0.0]))
    estimates = system.estimates

    def elsewhere(*asked) -> gtsam.Values:
        values = estimates(*asked)
        for key in (entry.keys.pose, *cameras):
            values.update(key, shift.compose(values.atPose3(key)))
        return values

    cameras = cameras_of(entry.observations)
    left = estimates([entry], cameras)
    before = [(o.quadratic, o.point) for o in entry.observations]
    with monkeypatch.context() as patch:
        patch.setattr(system, "estimates", elsewhere)
        patch.setattr(upkeep, "linearize", lambda *_: pytest.fail("it was decoded"))
        assert objects.upkeep.renew([entry], Tolerance(10, 10, 10, 10)) == 0
    assert len({o.number for o in entry.observations}) == len(before)
    for observation, (quadratic, point) in zip(entry.observations, before, strict=True):
        assert system.smoother.holds(observation.number)
        if observation.camera is None:  # a camera that is known does not travel
            assert observation.point is point
            continue
        there = shift.compose(left.atPose3(observation.camera))
        assert observation.point.atPose3(observation.camera).equals(there, 1e-9)
        assert observation.quadratic is not None
        assert quadratic is not None
        here, moved = gtsam.Values(point), gtsam.Values(observation.point)
        for values in (here, moved):
            pose = values.atPose3(entry.keys.pose)
            values.update(entry.keys.pose, pose.retract(np.array([0.01, 0.02, -0.01, 0.03, 0.0, 0.02])))
        assert observation.quadratic.error(moved) == pytest.approx(quadratic.error(here), rel=1e-6)


def test_a_failed_update_leaves_the_map_as_it_was(world):
    objects = mapper()
    for frame in world.frames[:3]:
        objects.update(frame, world.detections(frame))
    before, frame = objects.estimate(), world.frames[3]
    counts = len(objects.cameras), len(objects.objects), [len(o.observations) for o in objects.objects]
    loose = gtsam.Values()
    loose.insert(L(0), gtsam.Pose3())
    loose.insert(L(1), gtsam.Pose3())
    between = gtsam.BetweenFactorPose3(L(0), L(1), gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6))
    with pytest.raises(SolveError, match="taken back"):
        objects.update(frame, world.detections(frame), factors=[between], values=loose)
    assert counts == (
        len(objects.cameras), len(objects.objects), [len(o.observations) for o in objects.objects]
    )  # fmt: skip
    after = objects.estimate()
    assert sorted(after.keys()) == sorted(before.keys())
    report = objects.update(frame, world.detections(frame))
    assert report.camera == X(3)
    assert distance(objects.pose(X(3)), world.truth[3]) < 0.1


def test_the_caller_s_own_factors_and_variables(world):
    objects = mapper()
    values = gtsam.Values()
    values.insert(L(0), np.array([1.0, 2.0, 0.5]))
    T = world.truth[0]
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    where = np.array([1.1, 1.9, 0.6])
    sight = gtsam.BearingRangeFactor3D(
        objects.next_camera,
        L(0),
        gtsam.Unit3(T.transformTo(where)),
        float(np.linalg.norm(T.transformTo(where))),
        noise,
    )
    objects.update(world.frames[0], [], factors=[sight], values=values)
    np.testing.assert_allclose(objects.system.smoother._isam.calculateEstimatePoint3(L(0)), where, atol=0.01)
    assert objects.batch().values.exists(L(0))


def test_what_cannot_be_used_is_said(world):
    objects = mapper()
    frame = world.frames[0]
    report = objects.update(frame, [Instance(1, "chair"), Instance(9, "chair")])
    assert any("object 9" in reason for reason in report.reasons)
    assert len(report.pending) == 1
    bad = replace(frame, T_world_camera=np.full((4, 4), np.nan))
    with pytest.raises(ObservationError, match="frame 0"):
        objects.update(bad, [])
    assert len(objects.cameras) == 1


def test_an_object_not_seen_again_is_given_up(world):
    objects = mapper(patience=2)
    objects.update(world.frames[0], world.detections(world.frames[0])[:1])
    assert len(objects.pending) == 1
    reports = [objects.update(frame, []) for frame in world.frames[1:5]]
    assert objects.pending == ()
    assert any("given up" in reason for report in reports for reason in report.reasons)


def test_behind_the_lag_cameras_go_and_objects_stay(world):
    objects, _ = mapped(replace(world, frames=world.frames[:8]), lag=3.5)
    assert not objects.system.smoother.has(X(0))
    assert objects.system.smoother.has(X(7))
    assert len(objects.objects) == len(world.states)
    for state in world.states:
        entry, far = nearest(objects, state)
        assert far < 0.1
        assert np.linalg.eigvalsh(objects.marginals(entry).matrix).min() > 0
    assert distance(objects.pose(X(7)), world.truth[7]) < 0.1
    with pytest.raises(SolveError, match="lag"):
        objects.batch()


def test_upkeep_that_fails_costs_no_frame(world, monkeypatch):
    objects = mapper()
    for frame in world.frames[:2]:
        objects.update(frame, world.detections(frame))

    def fail(*_):
        raise SolveError("the decoder is gone")

    monkeypatch.setattr(objects.upkeep, "renew", fail)
    report = objects.update(world.frames[2], world.detections(world.frames[2]))
    assert any("decoder is gone" in reason for reason in report.reasons)
    assert list(objects.cameras) == [X(0), X(1), X(2)]
    monkeypatch.undo()
    assert objects.update(world.frames[3], []).camera == X(3)


def test_doubles_are_merged(world, run):
    """A second entry of a chair, made by hand, leaves the map, and its views are the first one's."""
    objects, _ = mapped(replace(world, frames=world.frames[:4]))
    entry = objects.objects[0]
    placed = entry.placed_views
    double = TrackedObject("chair 99", type(entry.keys).numbered(99), entry.prior)
    objects.system.add_object(double, objects.state(entry), placed[:2])
    objects.places.note([double])
    count = len(placed)
    reasons = objects.entrance.merge(objects.objects)
    assert len(reasons) == 1
    assert len(objects.objects) == len(world.states)
    (left,) = [o for o in objects.objects if o in (entry, double)]
    assert len(left.placed_views) == count + 2
    gone = double if left is entry else entry
    assert not objects.system.smoother.has(gone.keys.pose)
