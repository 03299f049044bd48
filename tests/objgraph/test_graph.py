"""Objects in a graph that somebody else owns: his keys, his cameras, his optimiser."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, O, X

from factors.base import Annealing
from factors.errors import FactorError
from factors.state import ObjectKeys, ObjectState
from objgraph.errors import ObservationError, SolveError
from objgraph.graph import GraphConfig, ObjectGraph, ObjectHandle
from objgraph.sampling import SamplingConfig, observe
from objgraph.solve import LevenbergMarquardtConfig, SolverConfig
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=120, hits=60, free=60)
SHORT = SolverConfig(slopes=(60.0, 200.0), rounds=4)
OFF = np.array([0.05, -0.08, 0.03, 0.02, -0.03, 0.02, 0.05, -0.05, 0.03, -0.3, 0.3, -0.2, 0.1])
NEAR = np.array([0.04, -0.03, 0.05, 0.03, -0.05, 0.04])
"""A camera's error: some degrees, some centimetres."""


def pose_noise(rotation: float, translation: float):
    return gtsam.noiseModel.Diagonal.Sigmas([rotation] * 3 + [translation] * 3)


def empty(config: GraphConfig | None = None) -> ObjectGraph:
    return ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), config)


def views_of(state: ObjectState, azimuths=(0.3, 2.0)):
    return [observe(toy_frame([state], a, str(i), seed=i), 1, SAMPLING) for i, a in enumerate(azimuths)]


def moved(state: ObjectState, metres: float) -> ObjectState:
    T = state.T_world_object
    return replace(
        state, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + np.array([metres, 0, 0]))
    )


def pose_error(T: gtsam.Pose3, T_true: gtsam.Pose3) -> tuple[float, float]:
    """Radians and metres."""
    between = T_true.between(T)
    angle = np.linalg.norm(gtsam.Rot3.Logmap(between.rotation()))
    return float(angle), float(np.linalg.norm(between.translation()))


def test_a_chair_is_found_at_fixed_cameras():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state.retract(OFF), up_world=UP, name="the chair")
    for view in views_of(state):
        objects.observe(handle, view)
    (problem,) = objects.optimize(SHORT)
    assert problem.name == handle.name == "the chair"
    assert handle.views == ["0", "1"]
    found = objects.state(handle)
    angle, distance = pose_error(found.T_world_object, state.T_world_object)
    assert angle < np.radians(2)
    assert distance < 0.02
    assert objects.graph.size() == 3 + 2 * 2


def test_the_lean_is_free_without_an_up_direction():
    objects = empty()
    objects.add_object(toy_prior(), toy_state())
    assert objects.graph.size() == 2


def camera_graph(state: ObjectState, T_world_camera: gtsam.Pose3, view) -> tuple[ObjectGraph, ObjectHandle]:
    """An object whose pose is known well, seen from a camera that is not."""
    objects = empty()
    objects.values.insert(X(5), T_world_camera)
    objects.graph.push_back(gtsam.PriorFactorPose3(X(5), T_world_camera, pose_noise(0.1, 0.2)))
    handle = objects.add_object(toy_prior(), state, up_world=UP)
    objects.graph.push_back(
        gtsam.PriorFactorPose3(handle.keys.pose, state.T_world_object, pose_noise(1e-3, 1e-3))
    )
    objects.observe(handle, view, camera=X(5))
    return objects, handle


@pytest.mark.parametrize("azimuth", [0.3, 2.4])
def test_a_camera_is_pulled_back_to_where_it_saw_the_object(azimuth):
    state = toy_state()
    (view,) = views_of(state, [azimuth])
    truth = view.T_world_camera
    objects, handle = camera_graph(state, truth.retract(NEAR), view)
    objects.optimize(SHORT)
    before = pose_error(truth.retract(NEAR), truth)
    after = pose_error(objects.values.atPose3(X(5)), truth)
    assert after[0] < min(np.radians(1), 0.3 * before[0])
    assert after[1] < min(0.03, 0.4 * before[1])
    angle, distance = pose_error(objects.state(handle).T_world_object, state.T_world_object)
    assert angle < 5e-3
    assert distance < 5e-3


def test_what_was_seen_moves_with_the_camera_s_key():
    """Points stay in the camera's frame: camera and object moved together fit as before, the camera alone does not."""
    state = toy_state()
    (view,) = views_of(state, [0.3])
    shift = gtsam.Pose3(gtsam.Rot3.Rz(0.7), np.array([3.0, -2.0, 0.0]))
    costs = []
    for T_camera, T_object in (
        (view.T_world_camera, state.T_world_object),
        (shift.compose(view.T_world_camera), shift.compose(state.T_world_object)),
        (view.T_world_camera.retract(NEAR), state.T_world_object),
    ):
        objects = empty()
        objects.values.insert(X(0), T_camera)
        handle = objects.add_object(toy_prior(), replace(state, T_world_object=T_object))
        objects.observe(handle, view, camera=X(0))
        costs.append(sum(factor.loss(objects.values) for factor in handle.factors))
    assert costs[1] == pytest.approx(costs[0], rel=1e-3)
    assert costs[2] > 3 * costs[0]


def test_a_pose_given_at_the_call_replaces_the_view_s():
    state = toy_state()
    (view,) = views_of(state, [0.3])
    elsewhere = view.T_world_camera.retract(NEAR)
    losses = []
    for camera in (None, view.T_world_camera, elsewhere):
        objects = empty()
        handle = objects.add_object(toy_prior(), state)
        objects.observe(handle, view, camera)
        losses.append(handle.factors[0].loss(objects.values))
    assert losses[0] == losses[1] < losses[2]


def test_own_keys_and_free_numbers():
    objects = empty()
    own = ObjectKeys(gtsam.symbol("p", 7), gtsam.symbol("q", 7), gtsam.symbol("r", 7))
    objects.values.insert(ObjectKeys.numbered(1).log_scale, np.zeros(2))  # somebody's s1
    first = objects.add_object(toy_prior(), toy_state(), keys=own)
    second = objects.add_object(toy_prior(), toy_state())
    third = objects.add_object(toy_prior(), toy_state())
    assert first.keys == own
    assert second.keys == ObjectKeys.numbered(2)
    assert third.keys == ObjectKeys.numbered(3)
    assert objects.values.size() == 1 + 3 * 3
    np.testing.assert_allclose(objects.values.atVector(own.code), toy_state().code)
    assert len({handle.name for handle in objects.objects}) == 3


def test_own_keys_are_solved_and_have_marginals():
    state, objects = toy_state(), empty()
    own = ObjectKeys(L(3), 17, gtsam.symbol("r", 0))
    handle = objects.add_object(toy_prior(), state.retract(0.3 * OFF), up_world=UP, keys=own)
    for view in views_of(state):
        objects.observe(handle, view)
    objects.optimize(SHORT)
    assert pose_error(objects.state(handle).T_world_object, state.T_world_object)[1] < 0.02
    assert objects.marginals(handle).matrix.shape == (13, 13)


def test_taken_keys_are_an_error_that_changes_nothing():
    objects = empty()
    objects.values.insert(X(0), gtsam.Pose3())
    handle = objects.add_object(toy_prior(), toy_state())
    size = objects.graph.size()
    for taken in (handle.keys, ObjectKeys(O(9), gtsam.symbol("s", 9), X(0))):
        with pytest.raises(FactorError, match=r"o0|x0"):
            objects.add_object(toy_prior(), toy_state(), keys=taken)
    assert objects.values.size() == 4
    assert objects.graph.size() == size
    assert len(objects.objects) == 1


def test_a_code_of_another_length_is_an_error_that_names_it():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), replace(state, code=np.zeros(7)))
    objects.observe(handle, views_of(state, [0.3])[0])
    with pytest.raises(SolveError, match=r"chair 0: z0 holds a code of length 7, but the decoder takes 4"):
        objects.optimize(SHORT)


def test_a_camera_without_a_value_is_an_error_that_names_it():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state)
    objects.observe(handle, views_of(state, [0.3])[0], camera=X(3))
    with pytest.raises(SolveError, match="x3"):
        objects.optimize(SHORT)


def test_connected_parts():
    """Two chairs that share an unknown camera, a chair by itself, one without views, and the caller's own variables."""
    a, b, objects = toy_state(), moved(toy_state(1.0), 1.0), empty()
    graph, values = objects.graph, objects.values
    frame = toy_frame([a, b], 1.5)
    shared = [observe(frame, i, SAMPLING) for i in (1, 2)]
    for k in (0, 1, 8, 9):
        values.insert(X(k), shared[0].T_world_camera)
    for k in (0, 8):
        graph.push_back(gtsam.PriorFactorPose3(X(k), shared[0].T_world_camera, pose_noise(0.01, 0.01)))
    graph.push_back(gtsam.BetweenFactorPose3(X(8), X(9), gtsam.Pose3(), pose_noise(0.01, 0.01)))
    handles = [objects.add_object(toy_prior(), state) for state in (a, b, a, a)]
    for handle, view in zip(handles, shared, strict=False):
        objects.observe(handle, view, camera=X(0))
    objects.observe(handles[2], shared[0])  # at a fixed camera
    graph.remove(0)  # a caller may have taken a factor out
    graph.push_back(gtsam.PriorFactorPose3(X(0), shared[0].T_world_camera, pose_noise(0.01, 0.01)))

    parts = {problem.name: problem for problem in objects.problems()}
    assert set(parts) == {"chair 0, chair 1", "chair 2", "chair 3", "variables without objects"}
    assert parts["chair 0, chair 1"].factors == handles[0].factors + handles[1].factors
    assert parts["chair 2"].factors == handles[2].factors
    assert parts["chair 3"].factors == []
    keys = {name: set(problem.values.keys()) for name, problem in parts.items()}
    assert keys["chair 0, chair 1"] == {X(0), *handles[0].keys, *handles[1].keys}
    assert keys["variables without objects"] == {X(8), X(9)}
    assert sum(problem.graph.size() for problem in parts.values()) == graph.size() - 1
    whole = graph.error(values)
    assert sum(p.graph.error(p.values) for p in parts.values()) == pytest.approx(whole)


def test_one_part_s_failure_leaves_the_others_solved():
    state, objects = toy_state(), empty()
    good = objects.add_object(toy_prior(), state.retract(OFF), up_world=UP, name="good")
    bad = objects.add_object(toy_prior(), replace(state, code=np.full(4, np.nan)), up_world=UP, name="bad")
    for handle in (good, bad):
        objects.observe(handle, views_of(state)[0])
    with pytest.raises(SolveError, match="bad:") as caught:
        objects.optimize(SHORT)
    assert "good" not in str(caught.value)
    assert pose_error(objects.state(good).T_world_object, state.T_world_object)[1] < 0.03


def own_slam() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Two cameras and a landmark of the caller's, some way from their optimum."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    T = views_of(toy_state(), [0.3])[0].T_world_camera
    step = gtsam.Pose3(gtsam.Rot3.Rz(0.1), np.array([0.3, 0.0, 0.1]))
    graph.push_back(gtsam.PriorFactorPose3(X(0), T, pose_noise(0.05, 0.05)))
    graph.push_back(gtsam.BetweenFactorPose3(X(0), X(1), step, pose_noise(0.02, 0.03)))
    for k in (0, 1):
        sight = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
        graph.push_back(
            gtsam.BearingRangeFactor3D(
                X(k), L(0), gtsam.Unit3(np.array([0.1, 0.2, 1.0])), 2.0 + 0.1 * k, sight
            )
        )
    values.insert(X(0), T.retract(NEAR))
    values.insert(X(1), T.compose(step).retract(-NEAR))
    values.insert(L(0), T.transformFrom(np.array([0.3, 0.3, 1.8])))
    return graph, values


@pytest.mark.parametrize("evidence", [0.0, 1.0])
def test_an_object_without_information_leaves_the_caller_s_variables_alone(evidence):
    plain = ObjectGraph(*own_slam())
    exact = SolverConfig(
        slopes=(200.0,), rounds=2, inner=LevenbergMarquardtConfig(iterations=60, relative_tolerance=0.0)
    )
    plain.optimize(exact)
    objects = ObjectGraph(*own_slam(), GraphConfig(evidence=evidence))
    own_factors = objects.graph.size()
    state = toy_state()
    handle = objects.add_object(toy_prior(), state, up_world=UP)
    for k, view in enumerate(views_of(state, [0.3, 0.5])):
        objects.observe(handle, view, camera=X(k))
    assert [objects.graph.at(i).keys() for i in range(own_factors)] == [
        plain.graph.at(i).keys() for i in range(own_factors)
    ]
    # anything may hold the object: it must be determined without views too
    objects.graph.push_back(
        gtsam.PriorFactorPose3(handle.keys.pose, state.T_world_object, pose_noise(0.01, 0.01))
    )
    objects.optimize(exact)
    moves = [
        np.abs(plain.values.atPose3(X(k)).localCoordinates(objects.values.atPose3(X(k)))).max()
        for k in (0, 1)
    ]
    moves.append(np.abs(plain.values.atPoint3(L(0)) - objects.values.atPoint3(L(0))).max())
    if evidence == 0.0:
        assert max(moves) < 1e-9
    else:
        assert min(moves) > 1e-3  # the same object with information does move them


def factors_of(graph: gtsam.NonlinearFactorGraph) -> list[tuple[int, gtsam.NonlinearFactor]]:
    return [(i, graph.at(i)) for i in range(graph.size()) if graph.exists(i)]


def test_what_was_added_can_be_taken_out_again():
    objects = ObjectGraph(*own_slam(), up_world=UP, floor=0.0)
    before, values = factors_of(objects.graph), gtsam.Values(objects.values)
    state = toy_state()
    views = views_of(state, [0.3, 0.5])
    first = objects.add_object(toy_prior(), state)
    objects.observe(first, views[0], camera=X(0))
    objects.graph.push_back(
        gtsam.PriorFactorPose3(X(1), gtsam.Pose3(), pose_noise(1, 1))
    )  # the caller goes on
    second = objects.add_object(toy_prior(), moved(state, 1.0))
    objects.stand_on_floor(second, views)
    objects.observe(second, views[1], camera=X(1))

    objects.remove_object(first)
    assert objects.objects == [second]
    assert not any(objects.values.exists(key) for key in first.keys)
    assert objects.graph.error(objects.values) > 0  # nothing is left on what is gone
    objects.remove_object(second)
    after = factors_of(objects.graph)
    assert after[:-1] == before
    assert after[-1][1].keys() == [X(1)]
    assert objects.values.equals(values, 0.0)
    with pytest.raises(FactorError, match="not in this graph"):
        objects.remove_object(first)


def test_the_graph_is_as_long_as_before_once_everything_is_taken_out():
    objects = ObjectGraph(*own_slam())
    size = objects.graph.size()
    handles = [objects.add_object(toy_prior(), toy_state()) for _ in range(2)]
    for handle in handles:
        objects.remove_object(handle)
    assert objects.graph.size() == size


def test_an_object_that_the_caller_holds_stays():
    objects = empty()
    handle = objects.add_object(toy_prior(), toy_state())
    objects.graph.push_back(gtsam.PriorFactorPose3(handle.keys.pose, gtsam.Pose3(), pose_noise(1, 1)))
    size = objects.graph.size()
    with pytest.raises(FactorError, match=r"your factor 2 on o0"):
        objects.remove_object(handle)
    assert objects.graph.size() == size
    assert objects.objects == [handle]
    objects.graph.remove(0)
    with pytest.raises(FactorError, match="rearranged"):
        objects.remove_object(handle)


def test_a_detection_is_placed_where_its_camera_is_now():
    state = toy_state()
    (view,) = views_of(state, [0.3])
    shift = gtsam.Pose3(gtsam.Rot3.Rz(0.7), np.array([3.0, -2.0, 0.0]))
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP, floor=0.0)
    placed = view.at(shift.compose(view.T_world_camera))
    handle = objects.add_object(toy_prior(), placed)
    assert objects.graph.size() == 3 + 1  # priors and the floor; the view itself is for `observe`
    there = shift.compose(state.T_world_object).translation()
    assert np.linalg.norm(objects.state(handle).T_world_object.translation() - there) < 0.25
    objects.observe(handle, placed)
    objects.optimize(SHORT)
    assert np.linalg.norm(objects.state(handle).T_world_object.translation() - there) < 0.06


def test_a_detection_cannot_be_placed_without_an_up_direction():
    objects = empty()
    with pytest.raises(ObservationError, match=r"chair 0.*up_world"):
        objects.add_object(toy_prior(), views_of(toy_state(), [0.3]))
    assert objects.values.size() == 0


def test_joint_marginals_with_cameras():
    state = toy_state()
    (view,) = views_of(state, [0.3])
    objects, handle = camera_graph(state, view.T_world_camera, view)
    objects.refresh()
    joint = objects.joint_marginals(handle, [X(5)])
    full = gtsam.Marginals(objects.graph, objects.values)
    keys = gtsam.KeyVector([*handle.keys, X(5)])
    np.testing.assert_allclose(joint, full.jointMarginalCovariance(keys).fullMatrix(), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(joint[:13, :13], objects.marginals(handle).matrix, rtol=1e-6, atol=1e-9)
    assert np.abs(joint[:6, 13:]).max() > 1e-8


def test_the_caller_s_own_optimiser_works_after_refresh():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state.retract(0.5 * OFF), up_world=UP)
    for k, view in enumerate(views_of(state)):
        objects.values.insert(X(k), view.T_world_camera)
        objects.graph.push_back(gtsam.PriorFactorPose3(X(k), view.T_world_camera, pose_noise(0.002, 0.002)))
        objects.observe(handle, view, camera=X(k))
    for slope in (60.0, 200.0):
        objects.refresh(Annealing(slope))
        before = objects.graph.error(objects.values)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(8)
        optimiser = gtsam.LevenbergMarquardtOptimizer(objects.graph, objects.values, parameters)
        objects.values.update(optimiser.optimize())
        assert objects.graph.error(objects.values) < before
    angle, distance = pose_error(objects.state(handle).T_world_object, state.T_world_object)
    assert angle < np.radians(2)
    assert distance < 0.02
