"""Points and rays of all views in one pool, and what is drawn of it."""

from dataclasses import replace

import gtsam
import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.rays import box_interval
from factors.state import ObjectState
from factors.rays import RayCells
from factors.rendering import CLEAR
from objgraph.estimate.pool import Pool
from objgraph.estimate.terms import RaySteps, draw_rays
from tests.objgraph.estimate.adam_cases import DECODER, OFF, views
from tests.objgraph.estimate.adam_reference import canonical_sdf
from tests.toys import TOY_CODE, toy_state

angles = st.floats(-3, 3)
offsets = st.floats(-1, 1)


@settings(max_examples=50)
@given(
    st.tuples(angles, angles, angles),
    st.tuples(offsets, offsets, offsets),
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),
)
def test_rays_of_all_views_meet_the_box_where_each_views_do(turn, move, log_scale):
    state = ObjectState(
        gtsam.Pose3(gtsam.Rot3.Expmap(np.array(turn)), np.array(move)),
        np.array(log_scale),
        np.zeros(TOY_CODE),
    )
    pool = Pool.of(views())
    near, far = pool.rays.interval(state)
    start = 0
    for view in views():
        stop = start + len(view.rays.depth)
        expected = box_interval(state, view.T_world_camera, view.rays.directions_camera)
        np.testing.assert_allclose((near[start:stop], far[start:stop]), expected, rtol=1e-9, atol=1e-9)
        start = stop
    assert start == len(near)


def test_a_pool_holds_each_views_points_and_rays_in_the_world():
    pool = Pool.of(views())
    T = views()[1].T_world_camera
    first, count = len(views()[0].points_camera), len(views()[0].rays.depth)
    for p_world, p_camera in zip(pool.p_world[first:], views()[1].points_camera, strict=True):
        np.testing.assert_allclose(T.transformTo(p_world), p_camera, atol=1e-9)
    rays, some = views()[1].rays, pool.rays.take(np.arange(count, len(pool.rays.depth)))
    at = some.at(some.depth[:, None])[:, 0]
    for p_world, direction, depth in zip(at, rays.directions_camera, rays.depth, strict=True):
        np.testing.assert_allclose(T.transformTo(p_world), depth * direction, atol=1e-9)
    for name in ("depth", "hit", "end", "sigma"):
        np.testing.assert_array_equal(getattr(some, name), getattr(rays, name))


def test_a_draw_repeats_nothing_and_keeps_rays_whole():
    pool = Pool.of(views())
    drawn = pool.draw(np.random.default_rng(0), 50, 30)
    assert drawn.p_world.shape == (50, 3)
    assert len(np.unique(drawn.p_world, axis=0)) == 50
    for i, direction in enumerate(drawn.rays.direction_world):
        (index,) = np.flatnonzero((pool.rays.direction_world == direction).all(axis=1))
        for name, array in vars(drawn.rays).items():
            np.testing.assert_array_equal(array[i], getattr(pool.rays, name)[index])
    whole = pool.draw(np.random.default_rng(0), 10**6, 10**6)
    np.testing.assert_array_equal(np.sort(whole.rays.depth), np.sort(pool.rays.depth))
    np.testing.assert_array_equal(np.sort(whole.p_world, axis=0), np.sort(pool.p_world, axis=0))


def test_drawn_rays_step_through_the_box_and_leave_out_free_ones_that_cannot_meet_it():
    state, steps = toy_state().retract(OFF), RaySteps(samples=20)
    pool = Pool.of(views())
    near, far = pool.rays.interval(state)
    aside = np.arange(len(near)) % 5 == 0  # every fifth ends before the box
    pool = Pool(pool.p_world, replace(pool.rays, end=np.where(aside, near - 0.01, pool.rays.end)))
    (drawn,) = draw_rays(DECODER, [state], [pool], steps)
    meets = (far > near + 1e-3) & ~aside & (pool.rays.end > near)
    counts = np.flatnonzero(meets | pool.rays.hit)  # a hit that misses the box is not explained
    np.testing.assert_allclose(drawn.targets.depth, pool.rays.depth[counts])
    np.testing.assert_array_equal(drawn.targets.hit, pool.rays.hit[counts])
    missed = ~meets[counts]
    assert missed.any()
    assert (drawn.sdf[missed] == CLEAR).all()
    assert (drawn.cells.width[missed] == 0).all()
    assert not drawn.near[missed].any()
    kept, inside = np.flatnonzero(meets), torch.as_tensor(~missed)
    assert drawn.count == len(near) > len(kept) > 0
    drawn = replace(
        drawn,
        cells=RayCells(*(part[inside] for part in vars(drawn.cells).values())),
        sdf=drawn.sdf[inside],
        near=drawn.near[inside],
    )
    np.testing.assert_allclose(drawn.cells.far, far[kept])
    edges = np.linspace(near[kept], far[kept], 21, axis=1)
    np.testing.assert_allclose(drawn.cells.depth, 0.5 * (edges[:, 1:] + edges[:, :-1]))
    np.testing.assert_allclose(drawn.cells.width, np.diff(edges, axis=1))
    p_world = pool.rays.take(kept).at(drawn.cells.depth.numpy())
    scale = np.exp(state.log_scale.mean())
    np.testing.assert_allclose(
        drawn.sdf.numpy().ravel(), scale * canonical_sdf(state, p_world.reshape(-1, 3)), atol=1e-9
    )
    np.testing.assert_array_equal(drawn.p_near, p_world[drawn.near.numpy()])
    assert 0.02 < drawn.near.double().mean() < 0.7
