"""The floor's height: made-up scenes, and two real ones with a known floor."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph.datasets import load_scan
from objgraph.observation.floor import estimate_floor

UP = np.array([0.0, 0.0, 1.0])


def _sheet(rng, low, high, count=4000):
    return rng.uniform(low, high, (count, 3))


def _room(seed=0, noise=0.005, floor=True):
    """A floor of 3 m x 3 m at height 0, two walls, and a table top at 0.7 m with four legs."""
    rng = np.random.default_rng(seed)
    parts = [
        _sheet(rng, [0, 0, 0], [0, 3, 2], 8000),
        _sheet(rng, [0, 0, 0], [3, 0, 2], 8000),
        _sheet(rng, [1, 1, 0.7], [2.5, 2, 0.7], 9000),
        *(_sheet(rng, [x, y, 0], [x + 0.05, y + 0.05, 0.7], 100) for x in (1, 2.4) for y in (1, 1.9)),
    ]
    if floor:
        parts.append(_sheet(rng, [0, 0, 0], [3, 3, 0]))
    points = np.concatenate(parts)
    return points + rng.normal(scale=noise, size=points.shape)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**31), st.floats(-20, 20), st.floats(0, 0.015))
def test_height_in_any_frame(seed, height, noise):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    points = (_room(seed % 7, noise) + height * UP) @ rotation.T
    found = estimate_floor(points, 3 * rotation @ UP)  # the length of `up` does not matter
    assert found == pytest.approx(height, abs=0.01)


def test_the_density_of_points_does_not_matter():
    points = _room()
    table = points[:, 2] > 0.6
    assert estimate_floor(np.concatenate([points, *4 * [points[table]]]), UP) == pytest.approx(0, abs=0.01)
    assert estimate_floor(points[::6], UP) == pytest.approx(0, abs=0.01)


def test_a_dense_patch_on_the_floor_is_not_the_floor():
    rng = np.random.default_rng(3)
    patch = _sheet(rng, [2.6, 2.6, 0.045], [2.9, 2.9, 0.045], 20_000)
    assert estimate_floor(np.concatenate([_room(), patch]), UP) == pytest.approx(0, abs=0.01)


def test_stray_points_below_do_not_move_it():
    rng = np.random.default_rng(1)
    stray = rng.uniform([0, 0, -1.5], [0.5, 0.5, -0.1], (300, 3))
    assert estimate_floor(np.concatenate([_room(), stray]), UP) == pytest.approx(0, abs=0.01)


def test_points_that_are_not_finite_are_left_out():
    bad = np.array([[np.nan, 0, -9], [np.inf, 0, -9], [0, -np.inf, -9]])
    assert estimate_floor(np.concatenate([_room(), bad]), UP) == pytest.approx(0, abs=0.01)


def test_none_without_a_floor():
    rng = np.random.default_rng(2)
    assert estimate_floor(np.zeros((0, 3)), UP) is None
    assert estimate_floor(np.full((10, 3), np.nan), UP) is None
    assert estimate_floor(np.zeros((10, 3)), UP) is None
    assert estimate_floor(_sheet(rng, [0, 0, 0], [4, 0, 3]), UP) is None  # a wall
    assert estimate_floor(_sheet(rng, [0, 0, 0], [3, 3, 3]), UP) is None  # a cloud
    assert estimate_floor(_sheet(rng, [0, 0, 0], [0.5, 0.5, 0]), UP) is None  # too small
    assert estimate_floor(_room(floor=False), UP) is None  # a table top, with walls and legs reaching below


def _cloud(scan, stride=8):
    parts = []
    for frame in scan.frames:
        v, u = np.mgrid[: frame.depth.shape[0] : stride, : frame.depth.shape[1] : stride]
        depth = frame.depth[v, u]
        p_camera = frame.intrinsics.backproject(u, v) * depth[..., None]
        p_world = p_camera @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
        parts.append(p_world[depth > 0])
    return np.concatenate(parts)


def test_the_real_scan(shared_data):
    scan = load_scan("scannet", shared_data / "scannet", stride=8)
    points = _cloud(scan)
    floor = estimate_floor(points, scan.up_world)
    # the scan's mesh has its densest horizontal layer between 5 and 7 cm
    assert floor == pytest.approx(0.06, abs=0.015)


def test_the_real_sequence(shared_data):
    scan = load_scan("sevenscenes", shared_data / "sevenscenes", stride=16)
    # the plane that was fitted by hand to the fused cloud: up . x + 1.52677 = 0
    assert estimate_floor(_cloud(scan), scan.up_world) == pytest.approx(-1.52677, abs=0.015)


def test_a_point_at_the_other_end_of_the_world_changes_nothing():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2, 2, (4000, 2)), 0.005 * rng.normal(size=4000)])
    up = np.array([0.0, 0.0, 1.0])
    astray = np.vstack([points, [[0.0, 0.0, 4e7], [0.0, 0.0, -4e7]]])
    assert estimate_floor(astray, up) == estimate_floor(points, up) is not None
