"""How far objects of a graph are to be trusted: as estimates of the same are, from where the cameras are now."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.covariance.box import box_pose
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.errors import CovarianceError, ObservationError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.initialise import FirstStates, first_states
from objgraph.graph.object_graph import ObjectGraph
from objgraph.priors.mesh import extract_mesh
from objgraph.trust.judge import _other_headings, judge, judge_estimate
from tests.objgraph.graph.graph_cases import SHORT, UP, pose_noise, views_of
from tests.objgraph.trust.calibrations import calibration
from tests.toys import toy_prior, toy_state

PRIOR = replace(toy_prior(), category="chair")
KNOWN = calibration(PRIOR.digest)
HERE = gtsam.Pose3()
SHIFT = gtsam.Pose3(gtsam.Rot3.Rz(0.7), np.array([3.0, -2.0, 0.0]))


def solved(
    up_world: np.ndarray | None = UP, *, body_T_camera: gtsam.Pose3 | None = None, shift: gtsam.Pose3 = HERE
):
    """A chair seen by two cameras, or bodies that carry them, whose poses are variables."""
    state = toy_state(1.0)
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=up_world, floor=0.0)
    placed = replace(state, T_world_object=shift.compose(state.T_world_object))
    chair = objects.add_object(PRIOR, placed, name="the chair")
    for k, view in enumerate(views_of(state)):
        pose = shift.compose(view.T_world_camera)
        pose = pose if body_T_camera is None else pose.compose(body_T_camera.inverse())
        objects.values.insert(X(k), pose)
        objects.graph.push_back(gtsam.PriorFactorPose3(X(k), pose, pose_noise(1e-3, 1e-3)))
        objects.observe(chair, view, X(k), body_T_camera=body_T_camera)
    objects.optimize(SHORT)
    return objects, chair


@pytest.fixture(scope="module")
def graph():
    return solved()


def test_an_object_is_judged_as_an_estimate_of_the_same_is(graph):
    objects, chair = graph
    found = judge(objects, chair, KNOWN)
    assert found is not None
    state, views = objects.state(chair), objects.views(chair)
    first = first_states(PRIOR, views, objects.builder)
    task = EstimationTask("the chair", PRIOR, first.states, tuple(views), UP, 0.0)
    estimate = Estimate(state, objects.marginals(chair), 1.0, 1.0, 1, 1)
    vertices = state.to_world(np.asarray(extract_mesh(PRIOR.decoder, state.code).vertices))
    expected = judge_estimate(task, estimate, vertices, KNOWN)
    assert expected is not None
    assert found.trust == expected.trust
    assert found.trust.calibration == KNOWN.digest
    np.testing.assert_array_equal(found.box.covariance.matrix, expected.box.covariance.matrix)
    raw = box_pose(PRIOR, state, objects.marginals(chair))
    assert np.linalg.eigvalsh(found.box.covariance.matrix - raw.covariance.matrix).min() > 0
    np.testing.assert_allclose(found.box.extents, raw.extents)


@pytest.mark.parametrize("carried", [False, True])
def test_views_are_where_their_cameras_are_now(graph, carried):
    """They were observed elsewhere: what counts is where object and cameras stand in the graph."""
    body_T_camera = gtsam.Pose3(gtsam.Rot3.RzRyRx(-1.6, 0.1, -1.5), np.array([0.2, -0.1, 0.4]))
    objects, chair = solved(shift=SHIFT, body_T_camera=body_T_camera if carried else None)
    here, there = judge(*graph, calibration=KNOWN), judge(objects, chair, KNOWN)
    assert here is not None
    assert there is not None
    assert there.trust.pose == pytest.approx(here.trust.pose, abs=0.02)
    for name in ("seen", "off", "through"):
        assert there.trust.evidence[name] == pytest.approx(here.trust.evidence[name], abs=0.03)
    between = graph[0].state(graph[1]).T_world_object.compose(gtsam.Pose3())
    moved = SHIFT.inverse().compose(objects.state(chair).T_world_object)
    assert np.linalg.norm(between.between(moved).translation()) < 0.02


def test_headings_that_the_map_knows_of_are_in_the_box(graph):
    objects, chair = graph
    turns = HeadingModes(np.array([0.7, 0.0, 0.3, 0.0]))
    chair.other_headings = turns
    try:
        turned = judge(objects, chair, KNOWN)
    finally:
        chair.other_headings = None
    alone = judge(objects, chair, KNOWN)
    assert turned is not None
    assert alone is not None
    assert (turned.trust.evidence["heading"], alone.trust.evidence["heading"]) == (0.7, 1.0)
    matrix = alone.box.covariance.matrix + turns.second_moment(alone.box.extents)
    np.testing.assert_allclose(turned.box.covariance.matrix, matrix, rtol=1e-6, atol=1e-12)


def test_a_first_guess_says_how_likely_other_headings_are():
    state = toy_state(1.0)
    turned = [
        replace(
            state, T_world_object=state.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Ry(a), np.zeros(3)))
        )
        for a in (0.1, np.pi + 0.2)
    ]
    found = _other_headings(state, FirstStates(tuple(turned), (0.6, 0.2)))
    assert found is not None
    np.testing.assert_allclose(found.probability, [0.75, 0, 0.25, 0])
    # the guess knows nothing of how it stands now
    elsewhere = _other_headings(state, FirstStates(tuple(turned[1:]), (0.2,)))
    assert elsewhere is not None
    np.testing.assert_allclose(elsewhere.probability, [0, 0, 1, 0])
    assert _other_headings(state, FirstStates(tuple(turned))) is None


def test_of_objects_that_it_does_not_know_it_says_nothing(graph):
    assert judge(*graph, calibration=calibration("other weights")) is None
    assert judge(*graph) is None  # the shipped one is of the shipped priors


def test_what_cannot_be_judged_is_told(graph):
    objects, chair = graph
    with pytest.raises(CovarianceError, match="calibration"):
        judge(objects, chair, "shipped")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ObservationError, match="which way is up"):
        judge(*solved(None), calibration=KNOWN)
