"""Rays from below the floor."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.state import ObjectState
from objgraph.ground import rays_from_below
from objgraph.object_factors import GraphConfig
from objgraph.sampling import SamplingConfig, observe
from objgraph.single_object import single_object
from tests.objgraph.test_initial_box import turned, ups
from tests.toys import toy_frame, toy_prior, toy_state


@given(ups, st.floats(-2, 2), st.floats(0.05, 0.4))
def test_every_ray_ends_at_the_floor_and_they_cover_what_is_above(up, floor, spacing):
    up = np.array(up, float) / np.linalg.norm(up)
    points = turned(np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3)), up, 0.3) + (floor + 0.5) * up
    T_world_camera, rays = rays_from_below(points, up, floor, spacing)
    ends = (rays.directions_camera * rays.end[:, None]) @ T_world_camera.rotation().matrix().T
    ends = ends + T_world_camera.translation()
    np.testing.assert_allclose(ends @ up, floor, atol=1e-9)
    assert not rays.hit.any()
    level = points - np.outer(points @ up - floor, up)
    nearest = np.linalg.norm(level[:, None] - ends[None], axis=2).min(axis=1)
    assert nearest.max() <= spacing


def test_an_object_under_the_floor_is_lifted():
    state = toy_state()
    view = observe(toy_frame([state], 0.3), 1, SamplingConfig(points=80, hits=40, free=40))

    def cost(sunk: float) -> float:
        moved = ObjectState(
            gtsam.Pose3(state.T_world_object.rotation(), state.T_world_object.translation() - [0, 0, sunk]),
            state.log_scale,
            state.code,
        )
        up = np.array([0.0, 0.0, 1.0])
        problem = single_object(toy_prior(), moved, [view], up, 0.0, GraphConfig()).problem
        return problem.factors[-1].loss(problem.values)

    on_the_floor, sunk = cost(0.0), cost(0.2)
    assert sunk > on_the_floor + 3
    assert cost(-0.2) == pytest.approx(0.0, abs=0.5)
