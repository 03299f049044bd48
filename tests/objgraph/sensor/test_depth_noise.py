"""Noise of patches: of known offsets, and of walls that are known to lie apart."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from objgraph.observation.sampling import SensorNoise
from objgraph.sensor.depth_noise import fitted_noise, patch_offsets
from objgraph.sensor.registration import Pair


def drawn(noise: SensorNoise, count: int, seed: int) -> np.ndarray:
    """Offsets between two frames, each with that noise."""
    rng = np.random.default_rng(seed)
    z_i, z_j = rng.uniform(0.8, 3.5, size=(2, count))
    return np.stack([rng.normal(size=count) * np.hypot(noise(z_i), noise(z_j)), z_i, z_j], axis=1)


@settings(max_examples=15, deadline=None)
@given(st.floats(5e-4, 0.01), st.floats(3e-4, 5e-3), st.integers(0, 100))
@example(0.001393770502952655, 0.00390625, 24)
def test_the_noise_of_one_frame_is_found_from_differences(base: float, quadratic: float, seed: int):
    true = SensorNoise(base, quadratic)
    found = fitted_noise(drawn(true, 12_000, seed))
    depths = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(found(depths), true(depths), rtol=0.25)


def test_a_tenth_that_moved_changes_little():
    true = SensorNoise(0.002, 0.001)
    offsets = drawn(true, 3000, 0)
    offsets[::10, 0] = 0.04
    depths = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(fitted_noise(offsets)(depths), true(depths), rtol=0.3)


def wall(z: float) -> o3d.geometry.PointCloud:
    """Square to the optical axis."""
    x, y = np.meshgrid(np.arange(-0.6, 0.6, 0.02), np.arange(-0.6, 0.6, 0.02))
    return o3d.geometry.PointCloud(
        o3d.utility.Vector3dVector(np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1))
    )


@pytest.mark.parametrize("off", [0.0, 0.01, -0.02])
def test_a_wall_that_is_off_is_off_by_as_much_in_each_patch(off: float):
    T_j_i = np.eye(4)
    T_j_i[2, 3] = 0.5
    offsets = patch_offsets(Pair(0, 1, T_j_i), [wall(2.0), wall(2.5 + off)], 0.2)
    assert len(offsets) > 10
    np.testing.assert_allclose(np.abs(offsets[:, 0]), abs(off), atol=1e-9)
    np.testing.assert_allclose(offsets[:, 1:], [[2.0, 2.5]] * len(offsets), atol=1e-9)


def test_what_only_one_frame_sees_is_no_patch():
    assert patch_offsets(Pair(0, 1, np.eye(4)), [wall(2.0), wall(3.0)], 0.2).shape == (0, 3)
