"""The first guess network: frames of the four quarters, and what turning the object does."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from objgraph.geometry.frames import upright_axes
from objgraph.observation.gravity_box import GravityBox
from objgraph.priors.first_guess import (
    QUARTERS,
    FirstGuess,
    FirstGuessConfig,
    place_from_quarter,
    place_in_quarter,
    quarter_turned,
)

angles = st.floats(-np.pi, np.pi)


def box_at(heading: float, rng: np.random.Generator) -> GravityBox:
    up = np.array([0.1, -0.3, 1.0])
    return GravityBox(rng.normal(size=3), rng.uniform(0.3, 1, 3), upright_axes(up, heading))


def random_cloud(rng: np.random.Generator, config: FirstGuessConfig) -> torch.Tensor:
    return torch.from_numpy(rng.normal(size=(1, config.surface + config.free, 8))).float()


@settings(max_examples=50, deadline=None)
@given(angles, angles, st.integers(0, 2**31))
def test_places_go_there_and_back(seen: float, heading: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    box, log_scale = box_at(seen, rng), rng.normal(size=3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = upright_axes(np.array([0.1, -0.3, 1.0]), heading), rng.normal(size=3)
    quarter, place = place_in_quarter(box, 0.8, T, log_scale)
    assert 0 <= quarter < QUARTERS
    assert abs(place[0]) <= np.pi / 4 + 1e-9
    T_again, log_scale_again = place_from_quarter(box, 0.8, quarter, place)
    assert_allclose(T_again, T, atol=1e-9)
    assert_allclose(log_scale_again, log_scale, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 3), st.integers(0, 2**31))
def test_a_turned_cloud_lies_in_the_quarters_frame(quarter: int, seed: int) -> None:
    """Points of an object at a quarter turn are, turned, where they are in its own frame."""
    rng = np.random.default_rng(seed)
    box = GravityBox(np.zeros(3), np.ones(3), np.eye(3))
    T, _ = place_from_quarter(box, 1.0, quarter, np.zeros(7))
    p_object = rng.normal(size=(5, 3))
    p_box = p_object @ T[:3, :3].T
    cloud = torch.from_numpy(np.concatenate([p_box, p_box, np.zeros((5, 2))], axis=1))
    turned = quarter_turned(cloud, quarter).numpy()
    assert_allclose(turned[:, :3], p_object, atol=1e-9)
    assert_allclose(turned[:, 3:6], p_object, atol=1e-9)


def test_turning_what_is_seen_turns_the_headings() -> None:
    rng, config = (
        np.random.default_rng(0),
        FirstGuessConfig(code_length=4, surface=20, free=10, heading_width=16, place_width=16, hidden=16),
    )
    torch.manual_seed(0)
    network = FirstGuess(config)
    points, size = random_cloud(rng, config), torch.tensor([[0.5, 0.8, 1.1]])
    with torch.no_grad():
        first, turned = network(points, size), network(quarter_turned(points, 1), size[:, [2, 1, 0]])
    assert_allclose(turned.log_probability, first.log_probability.roll(-1, dims=1), atol=1e-5)
    assert_allclose(turned.mean, first.mean.roll(-1, dims=1), atol=1e-5)
    assert_allclose(first.log_probability.exp().sum(), 1.0, atol=1e-6)


def test_the_order_of_points_says_nothing() -> None:
    rng, config = (
        np.random.default_rng(1),
        FirstGuessConfig(code_length=4, surface=20, free=10, heading_width=16, place_width=16, hidden=16),
    )
    network, points, size = FirstGuess(config), random_cloud(rng, config), torch.ones(1, 3)
    with torch.no_grad():
        mixed = network(points[:, torch.from_numpy(rng.permutation(30))], size)
        assert_allclose(mixed.mean, network(points, size).mean, atol=1e-5)
