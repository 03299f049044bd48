"""Objects in a graph: found at fixed cameras and at unknown ones, in parts, by ours and the caller's optimiser."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.base import Annealing
from objgraph.errors import ObservationError, SolveError
from objgraph.graph.builder import DetectedBox
from objgraph.graph.object_graph import ObjectGraph
from objgraph.observation.sampling import observe
from tests.objgraph.graph.graph_cases import (
    NEAR,
    OFF,
    SAMPLING,
    SHORT,
    UP,
    camera_graph,
    empty,
    moved,
    pose_error,
    pose_noise,
    views_of,
)
from tests.toys import toy_frame, toy_prior, toy_state


def test_a_chair_is_found_at_fixed_cameras():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state.retract(OFF), name="the chair")
    for view in views_of(state):
        objects.observe(handle, view)
    (problem,) = objects.optimize(SHORT)
    assert problem.name == handle.name == "the chair"
    assert [view.frame for view in objects.views(handle)] == ["0", "1"]
    found = objects.state(handle)
    angle, distance = pose_error(found.T_world_object, state.T_world_object)
    assert angle < np.radians(2)
    assert distance < 0.02
    assert objects.graph.size() == 3 + 2 * 2


def test_the_lean_is_free_without_an_up_direction():
    objects = empty(up_world=None)
    objects.add_object(toy_prior(), toy_state())
    assert objects.graph.size() == 2


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
    good = objects.add_object(toy_prior(), state.retract(OFF), name="good")
    bad = objects.add_object(toy_prior(), state, name="bad")
    objects.values.update(bad.keys.code, np.full(4, np.nan))
    for handle in (good, bad):
        objects.observe(handle, views_of(state)[0])
    told: list[tuple[int, int]] = []
    with pytest.raises(SolveError, match="bad:") as caught:
        objects.optimize(SHORT, lambda *rounds: told.append(rounds))
    assert told[0] == (1, SHORT.rounds)
    assert "good" not in str(caught.value)
    assert pose_error(objects.state(good).T_world_object, state.T_world_object)[1] < 0.03


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


def test_a_detector_s_box_says_how_an_object_is_placed():
    state, objects = toy_state(), empty()
    half = state.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3)))
    prior = toy_prior()
    box = DetectedBox(half, state.scale * prior.start_extents[0], 0.05, 0.05, 0.05)
    by_views, by_box = (objects.add_object(prior, views_of(state), box=each) for each in (None, box))
    assert pose_error(objects.state(by_views).T_world_object, half)[0] > np.radians(150)
    assert pose_error(objects.state(by_box).T_world_object, half)[0] < np.radians(30)


def test_a_detection_cannot_be_placed_without_an_up_direction():
    objects = empty(up_world=None)
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


def test_joint_marginals_are_asked_of_the_parts_that_hold_the_keys_alone():
    state = toy_state()
    (view,) = views_of(state, [0.3])
    objects, handle = camera_graph(state, view.T_world_camera, view)
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    objects.values.insert(X(6), gtsam.Pose3())
    objects.graph.push_back(gtsam.PriorFactorPose3(X(6), gtsam.Pose3(), noise))
    for k in (7, 8, 9):  # of two of these nothing says where they are, of the third nothing at all
        objects.values.insert(X(k), gtsam.Pose3())
    objects.graph.push_back(gtsam.BetweenFactorPose3(X(7), X(8), gtsam.Pose3(), noise))
    objects.refresh()
    joint = objects.joint_marginals(handle, [X(6)])
    np.testing.assert_allclose(joint[:13, :13], objects.marginals(handle).matrix, rtol=1e-9)
    np.testing.assert_allclose(joint[13:, 13:], 0.01 * np.eye(6), atol=1e-12)
    assert not joint[:13, 13:].any()
    for key, words in ((X(7), "does not determine x7, x8"), (X(9), "does not determine x9 .no factor")):
        with pytest.raises(SolveError, match=words):
            objects.joint_marginals(handle, [X(6), key])
    with pytest.raises(SolveError, match="x10 has no covariance: it is not in the values"):
        objects.joint_marginals(handle, [X(10)])


def test_the_caller_s_own_optimiser_works_after_refresh():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state.retract(0.5 * OFF))
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


def test_a_long_trajectory_is_no_deep_recursion():
    """Chained backwards, as a union-find that recurses cannot follow."""
    objects, count = empty(), 20_000
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    for k in range(count):
        objects.values.insert(X(k), gtsam.Pose3())
    for k in range(count - 1):
        objects.graph.push_back(gtsam.BetweenFactorPose3(X(k + 1), X(k), gtsam.Pose3(), noise))
    (problem,) = objects.problems()
    assert problem.values.size() == count
