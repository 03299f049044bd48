"""Views from known cameras in one 3D and one 2D factor say what they say in factors of their own."""

import gtsam
import numpy as np
import pytest

from factors.base import Annealing
from factors.rays import Rays
from factors.state import ObjectKeys, ObjectState
from objgraph.graph.builder import ObjectBuilder
from tests.objgraph.graph.graph_cases import OFF, UP, moved, views_of
from tests.toys import toy_prior, toy_state

KEYS = ObjectKeys.numbered(0)
BUILDER = ObjectBuilder(up_world=UP, floor=0.0)
STATE = toy_state(1.0)
VIEWS = views_of(STATE, (0.3, 2.0, 4.1))


def said(factors, at: ObjectState, trial: ObjectState, slope: float):
    """Loss where it is frozen, loss after a step, and the normal equations, of all factors together."""
    values, after = gtsam.Values(), gtsam.Values()
    at.insert(values, KEYS)
    trial.insert(after, KEYS)
    loss, stepped, information, gradient = 0.0, 0.0, 0.0, 0.0
    for factor in factors:
        factor.refresh(values, Annealing(slope))
        rows = factor.rows(values)
        jacobian = rows.jacobian.double().numpy()
        loss, stepped = loss + factor.loss(values), stepped + factor.loss(after)
        information = information + jacobian.T @ jacobian
        gradient = gradient + jacobian.T @ rows.residual.double().numpy()
    return loss, stepped, information, gradient


@pytest.mark.parametrize("slope", [60.0, 400.0])
@pytest.mark.parametrize("at", [STATE, STATE.retract(OFF), moved(STATE, 0.8)])
def test_costs_gradients_and_information_are_the_sums(at, slope):
    """Of a shape far off as well, which some hits do not meet."""
    prior = toy_prior()
    apart = [f for view in VIEWS for f in BUILDER.view(prior, KEYS, view, view.T_world_camera)]
    together = BUILDER.views(prior, KEYS, VIEWS)
    assert (len(apart), len(together)) == (6, 2)
    trial = at.retract(0.2 * OFF)
    for one, other in zip(said(apart, at, trial, slope), said(together, at, trial, slope), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * np.abs(one).max())


def test_rays_of_another_frame_are_the_same_in_the_world():
    view = VIEWS[1]
    rays = view.rays.in_world(view.T_world_camera)
    R, t = view.T_world_camera.rotation().matrix(), view.T_world_camera.translation()
    expected = (view.rays.directions_camera * view.rays.depth[:, None]) @ R.T + t
    assert rays.origins_camera is not None
    np.testing.assert_allclose(rays.origins_camera + rays.directions_camera * rays.depth[:, None], expected)
    again = rays.in_world(view.T_world_camera.inverse())
    assert again.origins_camera is not None
    np.testing.assert_allclose(again.directions_camera, view.rays.directions_camera, atol=1e-12)
    np.testing.assert_allclose(again.origins_camera, 0.0, atol=1e-12)
    p = np.array([0.3, -0.2, 0.5])
    beside = rays.depth_beside(p)
    nearest = rays.origins_camera + rays.directions_camera * beside[:, None] - p
    np.testing.assert_allclose((nearest * rays.directions_camera).sum(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(view.rays.depth_beside(view.T_world_camera.transformTo(p)), beside)


def test_rays_of_several_cameras_are_those_of_each():
    several = [view.rays.in_world(view.T_world_camera) for view in VIEWS]
    together = Rays.together(several)
    first = len(several[0].depth)
    np.testing.assert_array_equal(
        together.take(np.arange(first)).directions_camera, several[0].directions_camera
    )
    assert len(together.depth) == sum(len(each.depth) for each in several)
