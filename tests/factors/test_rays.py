import gtsam
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from factors.errors import FactorError
from factors.rays import BOX_HALF_SIZE, Rays, box_interval, choose_cells, coarse_depths, passing_depth
from factors.state import ObjectState
from tests.factors.conftest import random_camera, random_state


@given(st.integers(0, 10**6), st.booleans())
def test_box_interval_holds_exactly_what_lies_in_the_box(seed, tight):
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.1, 0.6, size=3) if tight else BOX_HALF_SIZE
    state, camera = random_state(rng), random_camera(rng)
    directions = np.c_[rng.normal(size=(20, 2)) * 0.2, np.ones(20)]
    near, far = box_interval(state, camera, directions, half)
    depth = np.linspace(0.05, 6, 400)
    points = directions[:, None] * depth[:, None]
    p_world = points.reshape(-1, 3) @ camera.rotation().matrix().T + camera.translation()
    inside = (np.abs(state.to_object(p_world)) < half).all(axis=1).reshape(20, 400)
    between = (depth > near[:, None]) & (depth < far[:, None])
    np.testing.assert_array_equal(inside, between)


@given(st.integers(0, 10**6), st.floats(0.5, 3.5))
def test_cells_partition_the_ray_and_no_cell_straddles_the_observation(seed, observed):
    generator = torch.Generator().manual_seed(seed)
    near, far = torch.tensor([1.0, 1.5]).double(), torch.tensor([2.0, 3.0]).double()
    sdf = torch.randn(2, 12, generator=generator).double() * 0.3
    observation = torch.full((2,), observed).double()
    cells = choose_cells(near, far, sdf, observation, observation, count=9, band=torch.full_like(near, 0.05))
    assert (cells.width >= 0).all()
    torch.testing.assert_close(cells.width.sum(dim=1), far - near)
    start, end = cells.depth - cells.width / 2, cells.depth + cells.width / 2
    assert (start[:, 0] - near).abs().max() < 1e-12
    straddles = (start < observation[:, None] - 1e-12) & (end > observation[:, None] + 1e-12)
    assert not straddles.any()


def test_cells_are_finest_at_the_surface():
    near, far = torch.zeros(1).double() + 1, torch.ones(1).double() + 1
    sdf = (1.4 - coarse_depths(near, far, 16)).abs()
    nowhere = torch.tensor([torch.inf]).double()
    cells = choose_cells(near, far, sdf, nowhere, nowhere, count=14, band=torch.full_like(near, 0.03))
    assert abs(float(cells.depth[0, cells.width.argmin()]) - 1.4) < 0.07
    assert cells.width.min() < 0.3 / 14


def test_a_hit_that_misses_the_box_leaves_it_no_sooner_than_through_it():
    """Half the box's diagonal, in metres, behind the middle; and behind the hit a whole one."""
    state = ObjectState(gtsam.Pose3(), np.log([0.5, 2.0, 1.0]), np.zeros(5))
    half = np.array([0.4, 0.25, 0.3])
    radius = np.sqrt(0.2**2 + 0.5**2 + 0.3**2)
    found = passing_depth(state, np.array([1.0, 4.0]), 3.0, half)
    np.testing.assert_allclose(found, [3.0 + radius, 4.0 + 2 * radius])


def _rays(**changes):
    rays = {"directions_camera": np.ones((2, 3)), "depth": np.ones(2), "hit": np.array([True, False])}
    return Rays(**{**rays, "end": np.array([2.0, np.inf]), "sigma": np.full(2, 0.01), **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"depth": np.array([np.nan, 1.0])},
        {"depth": np.array([-1.0, 1.0])},
        {"depth": np.array([1.0, np.inf])},
        {"end": np.array([np.nan, 1.0])},
        {"sigma": np.zeros(2)},
        {"sigma": np.full(2, np.inf)},
        {"depth": np.ones(3)},
        {"directions_camera": np.ones((2, 2))},
        {"directions_camera": np.full((2, 3), np.nan)},
    ],
)
def test_bad_rays_are_refused(changes):
    _rays()
    with pytest.raises(FactorError):
        _rays(**changes)


@given(st.lists(st.floats(-1, 3), min_size=2, max_size=2))
def test_a_hit_is_seen_up_to_its_depth_at_least(end):
    """An occluder beside it, or the hit's own depth, is no end of what it says of the object."""
    ends = np.array(end)
    np.testing.assert_array_equal(_rays(end=ends).end, [np.inf if end[0] <= 1 else end[0], end[1]])
    np.testing.assert_array_equal(ends, end)  # as they were given


def test_a_part_of_the_rays_keeps_them_whole():
    rays = _rays().take(np.array([1]))
    assert not rays.hit[0]
    assert rays.end[0] == np.inf


def test_a_camera_inside_the_box_looks_forward_only():
    state = random_state(np.random.default_rng(0))
    camera = gtsam.Pose3(gtsam.Rot3(), state.T_world_object.translation())
    near, far = box_interval(state, camera, np.array([[0.0, 0.0, 1.0]]))
    assert 0 < near[0] < far[0]
