"""The 9-DoF pose of an object's box and its covariance."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from trimesh.sample import sample_surface

from factors.state import ObjectState
from objgraph.covariance.box import BOX_AXES, box_jacobian, box_pose
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import SolveError
from tests.toys import ToyDecoder, toy_mesh, toy_prior, toy_state

COVARIANCE = ObjectCovariance.diagonal(np.square(np.linspace(0.01, 0.05, 13)), "marginals", "chair 1")


def box_of(state: ObjectState) -> tuple[gtsam.Pose3, np.ndarray]:
    """By hand, from the boxes that the toy is made of."""
    low, high = toy_mesh(state.code).bounds * state.scale
    centre = state.T_world_object.transformFrom((low + high) / 2)
    return gtsam.Pose3(state.T_world_object.rotation(), centre), high - low


def surface_points(code: np.ndarray) -> np.ndarray:
    """Densely on the sides, so that each has its share of points."""
    return np.concatenate([sample_surface(toy_mesh(code), 4000, seed=0)[0], toy_mesh(code).vertices])


def test_the_boxs_derivative_is_the_numerical_one():
    state = toy_state()
    found = box_jacobian(ToyDecoder().double(), state, surface_points(state.code))
    here, extents = box_of(state)
    step = 1e-6
    for i, e in enumerate(np.eye(13)):
        ends = [box_of(state.retract(sign * step * e)) for sign in (1, -1)]
        moves = [here.localCoordinates(end[0]) for end in ends]
        column = np.concatenate([moves[0] - moves[1], np.log(ends[0][1] / ends[1][1])]) / (2 * step)
        np.testing.assert_allclose(found[:, i], column, atol=2e-4)
    assert (extents > 0).all()


def test_the_box_is_that_of_the_mesh_and_has_its_propagated_covariance():
    prior, state = toy_prior(), toy_state()
    found = box_pose(prior, state, COVARIANCE, surface_points(state.code))
    T_world_box, extents = box_of(state)
    np.testing.assert_allclose(found.T_world_box.matrix(), T_world_box.matrix(), atol=1e-9)
    np.testing.assert_allclose(found.extents, extents, atol=1e-9)
    J = box_jacobian(prior.decoder, state, surface_points(state.code))
    np.testing.assert_allclose(found.covariance.matrix, J @ COVARIANCE.matrix @ J.T, atol=1e-12)
    assert found.covariance.axes == BOX_AXES
    made = box_pose(prior, state, COVARIANCE)
    np.testing.assert_allclose(made.extents, extents, atol=0.03)


def test_a_prior_whose_shapes_fill_a_box_has_that_one():
    prior, state = replace(toy_prior(), box=np.array([0.5, 0.7, 0.4])), toy_state()
    found = box_pose(prior, state, COVARIANCE)
    np.testing.assert_allclose(found.extents, state.scale * [0.5, 0.7, 0.4])
    np.testing.assert_array_equal(found.T_world_box.matrix(), state.T_world_object.matrix())
    np.testing.assert_allclose(found.covariance.matrix, COVARIANCE.rigid)
    assert (found.covariance.source, found.covariance.subject) == ("marginals", "chair 1")


def test_points_that_face_no_side_are_refused():
    state = toy_state()
    inner = np.tile([[0.0, 0.05, 0.0]], (5, 1)) + 1e-3 * np.eye(5, 3)
    with pytest.raises(SolveError, match="no surface faces"):
        box_jacobian(ToyDecoder().double(), state, inner)
