"""What has no heading says so."""

import gtsam
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from factors.state import ObjectState
from objgraph.covariance.heading_ring import HEADINGS, by_heading, heading_variance, with_other_headings
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import CovarianceError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import EstimationTask
from objgraph.graph.object_graph import ObjectGraph
from objgraph.graph.solve import SolverConfig
from objgraph.maps.of_graph import map_of
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.shape_prior import ShapePrior
from tests.toys import look_at, toy_mesh, toy_picture, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
ANGLES = 2 * np.pi * np.arange(HEADINGS) / HEADINGS
WRAPPED = np.minimum(ANGLES, 2 * np.pi - ANGLES)


def covariance(sigma: float) -> ObjectCovariance:
    return ObjectCovariance.diagonal(np.array([0.01, sigma, *[0.02] * 10]) ** 2, "marginals")


@given(st.floats(np.radians(0.1), np.radians(25)))
def test_a_gaussian_heading_is_left_as_it_is(sigma):
    before = covariance(sigma)
    after = with_other_headings(before, lambda: 0.5 * (WRAPPED / sigma) ** 2)
    np.testing.assert_allclose(after.matrix, before.matrix, rtol=0.02)


def test_no_heading_is_the_uniform_distribution():
    assert heading_variance(np.zeros(3600)) == pytest.approx(np.pi**2 / 3, rel=1e-5)
    after = with_other_headings(covariance(0.1), lambda: np.zeros(HEADINGS))
    assert after.sigma[1] == pytest.approx(np.pi / np.sqrt(3), rel=0.01)
    np.testing.assert_array_equal(np.delete(after.sigma, 1), np.delete(covariance(0.1).sigma, 1))


def test_two_ends_alike_are_half_a_turn_apart():
    costs = np.full(HEADINGS, 50.0)
    costs[[0, HEADINGS // 2]] = 0.0
    assert heading_variance(costs) == pytest.approx(np.pi**2 / 2)


def test_headings_at_which_the_decoder_fails_count_for_nothing():
    costs = np.zeros(HEADINGS)
    costs[1:] = np.nan
    assert heading_variance(costs) == 0.0


def test_a_heading_that_is_known_is_not_asked_for_elsewhere():
    def fail():
        raise AssertionError("it was asked for")

    before = covariance(np.radians(1.0))
    assert with_other_headings(before, fail) is before


def stool(_) -> trimesh.Trimesh:
    """A seat, a column and a round foot; y is up."""
    parts = [
        trimesh.creation.cylinder(
            radius, height, transform=trimesh.transformations.translation_matrix([0, 0, z])
        )
        for radius, height, z in ((0.17, 0.05, 0.425), (0.03, 0.4, 0.21), (0.15, 0.02, 0.01))
    ]
    mesh = trimesh.util.concatenate(parts)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))


def seen(prior: ShapePrior, state: ObjectState, mesh_of) -> tuple[list[ObjectView], ObjectState]:
    """Three views, and a start near `state`."""
    centre, views = np.array([*state.T_world_object.translation()[:2], 0.25]), []
    for i, angle in enumerate((0.3, 1.5, 2.6)):
        T = look_at(centre + 1.8 * np.array([np.cos(angle), np.sin(angle), 0.45]), centre)
        views.append(observe(toy_picture([state], T, str(i), 0.003, i, 4.0, mesh_of), 1, seed=i))
    size = np.array([0.34, 0.45, 0.34]) / 0.577 if prior.is_fallback else state.scale
    place = gtsam.Pose3(state.T_world_object.rotation(), np.array([*centre[:2], 0.23]))
    return views, ObjectState(place, np.log(size), prior.code_mean) if prior.is_fallback else state


def estimated(prior: ShapePrior, state: ObjectState, mesh_of) -> ObjectCovariance:
    views, start = seen(prior, state, mesh_of)
    (found,) = GraphEstimator(solver=SolverConfig(rounds=4)).estimate(
        [EstimationTask("it", prior, (start,), tuple(views), UP, 0.0)]
    )
    assert not isinstance(found, Exception)
    assert found.covariance is not None
    return found.covariance


@pytest.mark.parametrize("leans", [False, True])
def test_a_stool_in_a_graph_has_no_heading_either(leans):
    """Its marginals are one Gaussian's; its map's are as `objgraph map` has them, where it stands upright."""
    upright, prior = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.array([0.3, 0.2, 0.0])), fallback_prior("stool")
    views, start = seen(prior, ObjectState(upright, np.zeros(3), np.zeros(4)), stool)
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP, floor=0.0)
    it = objects.add_object(prior, start)
    for view in views:
        objects.observe(it, view, view.T_world_camera)
    objects.optimize(SolverConfig(rounds=4))
    if leans:
        place = objects.state(it).T_world_object
        lean = gtsam.Pose3(gtsam.Rot3.Rz(np.radians(80)), np.zeros(3))
        objects.values.update(it.keys.pose, place.compose(lean))
        objects.refresh()
    (entry,) = map_of(objects, resolution=24).objects
    if leans:
        np.testing.assert_allclose(entry.uncertainty.matrix[1, 1], objects.marginals(it).matrix[1, 1])
        return
    assert np.degrees(objects.marginals(it).sigma[1]) < 45
    assert np.degrees(np.sqrt(entry.uncertainty.matrix[1, 1])) > 60


def test_a_stool_has_no_heading_and_a_chair_has():
    upright = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.array([0.3, 0.2, 0.0]))
    round_one = estimated(fallback_prior("stool"), ObjectState(upright, np.zeros(3), np.zeros(4)), stool)
    chair = estimated(toy_prior(), toy_state(), toy_mesh)
    assert np.degrees(round_one.sigma[1]) > 60
    assert np.degrees(round_one.sigma[[0, 2]].max()) < 10
    assert round_one.sigma[3:6].max() < 0.05
    assert np.degrees(chair.sigma[1]) < 5


@pytest.mark.parametrize("matrix", [np.zeros((9, 9)), np.ones((9, 9))])
def test_a_covariance_without_an_inverse_is_refused(matrix):
    singular = ObjectCovariance.of(matrix, "marginals")
    with pytest.raises(CovarianceError, match="not positive definite"):
        with_other_headings(singular, lambda: np.zeros(HEADINGS))


@given(st.floats(np.radians(1), np.radians(50)), st.integers(0, 2**32 - 1))
def test_parts_by_heading_have_the_moments_of_the_whole(sigma, seed):
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(12, 12)) * np.array([0.01, 0.0, *[0.02] * 10])[:, None]
    mixing[1] = 0.0
    mixing = np.concatenate([mixing, sigma * np.array([0.1, 1.0, *[0.2] * 10])[:, None]], axis=1)
    before = ObjectCovariance.of(mixing @ mixing.T, "marginals")
    state = ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(3))
    parts = by_heading(state, before)
    # along the heading, which the pose's own tangent bends
    steps = [(share, turned.code[0] / 0.2, each.matrix) for share, turned, each in parts]
    assert sum(share for share, _, _ in steps) == pytest.approx(1, abs=3e-3)
    along = before.matrix[:, 1] / before.matrix[1, 1]
    spread = sum(share * turn**2 for share, turn, _ in steps) * np.outer(along, along)
    whole = sum(share * matrix for share, _, matrix in steps) + spread
    np.testing.assert_allclose(whole, before.matrix, atol=0.02 * sigma**2)
    assert max(each.sigma[1] for _, _, each in parts) < np.radians(15)


def test_of_a_heading_that_nothing_tells_all_are_as_likely():
    parts = by_heading(ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(3)), covariance(1e3))
    np.testing.assert_allclose([share for share, _, _ in parts], 1 / HEADINGS, rtol=1e-6)
    angles = [turned.T_world_object.rotation().matrix()[[0, 0], [2, 0]] for _, turned, _ in parts]
    found = np.sort(np.arctan2(*np.transpose(angles)) % (2 * np.pi))
    np.testing.assert_allclose(np.diff(found), 2 * np.pi / HEADINGS, atol=1e-6)
