"""Normals of seen points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from objgraph.observation.clouds import normals


def on_half_a_sphere(rng: np.random.Generator, count: int) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * np.sign(points[:, 2:])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31))
def test_normals_of_a_plane_are_its_own_and_towards_the_camera(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal, eye = rng.normal(size=3), rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    across = np.linalg.svd(normal[None])[2][1:]
    found = normals(rng.normal(size=(60, 2)) @ across, eye)
    assert_allclose(found, np.tile(normal * np.sign(normal @ eye), (60, 1)), atol=1e-9)


def test_normals_of_a_sphere_are_its_radii() -> None:
    points = on_half_a_sphere(np.random.default_rng(0), 300)
    found = normals(points, np.array([0.0, 0.0, 5.0]))
    inner = points[:, 2] > 0.4
    assert np.median((found * points).sum(axis=1)[inner]) > 0.99
    assert (found * points).sum(axis=1)[inner].min() > 0.9


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_few_points_have_normals_of_some_kind(count: int) -> None:
    points = on_half_a_sphere(np.random.default_rng(1), count)
    found = normals(points, np.array([0.0, 0.0, 5.0]))
    assert found.shape == (count, 3)
    assert_allclose(np.linalg.norm(found, axis=1), 1.0)
