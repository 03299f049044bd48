"""The first guess network: frames of the headings it looks at, which of them are one, and what turning the object does."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from objgraph.errors import PriorError
from objgraph.geometry.frames import upright_axes
from objgraph.observation.clouds import FEATURES
from objgraph.observation.gravity_box import GravityBox
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig, modes, place_in, placed

SMALL = FirstGuessConfig(
    code_length=4, headings=8, surface=20, free=10, heading_width=16, place_width=16, hidden=16
)
KINDS = [SMALL, replace(SMALL, normals=True)]
UP = np.array([0.1, -0.3, 1.0])
angles = st.floats(-np.pi, np.pi)


@settings(max_examples=50, deadline=None)
@given(angles, angles, st.integers(0, 2**31))
def test_places_go_there_and_back(seen: float, heading: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    looked = seen + np.array([0.0, 0.7, 2.0])
    boxes = GravityBox(rng.normal(size=(3, 3)), rng.uniform(0.3, 1, (3, 3)), upright_axes(UP, looked))
    log_scale, T = rng.normal(size=3), np.eye(4)
    T[:3, :3], T[:3, 3] = upright_axes(UP, heading), rng.normal(size=3)
    places = place_in(boxes, 0.8, T, log_scale)
    # of each heading, what is left to the object's
    assert_allclose(np.exp(1j * places[:, 0]), np.exp(1j * (heading - looked)), atol=1e-9)
    for k, place in enumerate(places):
        T_again, log_scale_again = placed(boxes[k], 0.8, place)
        assert_allclose(T_again, T, atol=1e-9)
        assert_allclose(log_scale_again, log_scale, atol=1e-9)


def test_headings_next_to_each_other_are_one() -> None:
    p = np.zeros(16)
    p[[0, 1, 15, 8, 9]] = [0.3, 0.1, 0.05, 0.35, 0.1]
    p += 0.1 / 16
    found = modes(p / p.sum())
    assert [heading for heading, _ in found][:2] == [0, 8] or [heading for heading, _ in found][:2] == [8, 0]
    assert sum(chance for _, chance in found) == pytest.approx(1.0)
    assert found == sorted(found, key=lambda mode: -mode[1])
    # at most one in an eighth of a turn
    places = np.sort([heading for heading, _ in found])
    assert (np.diff(places, append=places[0] + 16) > 2).all()


@settings(max_examples=50, deadline=None)
@given(st.sampled_from([4, 8, 16]), st.integers(0, 2**31))
def test_every_heading_is_of_one_mode(count: int, seed: int) -> None:
    p = np.random.default_rng(seed).dirichlet(np.full(count, 0.3))
    found = modes(p)
    assert sum(chance for _, chance in found) == pytest.approx(1.0)
    assert int(np.argmax(p)) in [heading for heading, _ in found]
    assert min(p[heading] - chance for heading, chance in found) <= 1e-12


@settings(max_examples=50, deadline=None)
@given(st.floats(0, 200), st.integers(0, 2**31))
def test_no_mode_is_more_than_certain(surer: float, seed: int) -> None:
    logits = torch.from_numpy(surer * np.random.default_rng(seed).normal(size=16)).float()
    found = modes(logits.log_softmax(dim=-1).exp().double().numpy())
    assert all(0 <= chance <= 1 for _, chance in found)


@pytest.mark.parametrize("config", KINDS)
def test_looking_from_another_heading_on_says_the_same_of_each(config: FirstGuessConfig) -> None:
    torch.manual_seed(0)
    network, rng = FirstGuess(config), np.random.default_rng(0)
    points = torch.from_numpy(rng.normal(size=(1, 8, 30, FEATURES))).float()
    size = torch.from_numpy(rng.uniform(0.5, 1, (1, 8, 3))).float()
    with torch.no_grad():
        first, turned = network(points, size), network(points.roll(3, dims=1), size.roll(3, dims=1))
    assert_allclose(turned.log_probability, first.log_probability.roll(3, dims=1), atol=1e-5)
    assert_allclose(turned.mean, first.mean.roll(3, dims=1), atol=1e-5)
    assert_allclose(first.log_probability.exp().sum(), 1.0, atol=1e-6)


@pytest.mark.parametrize("config", KINDS)
def test_the_order_of_points_says_nothing(config: FirstGuessConfig) -> None:
    network, rng = FirstGuess(config), np.random.default_rng(1)
    points = torch.from_numpy(rng.normal(size=(1, 8, 30, FEATURES))).float()
    with torch.no_grad():
        mixed = network(points[:, :, torch.from_numpy(rng.permutation(30))], torch.ones(1, 8, 3))
        given = network(points, torch.ones(1, 8, 3))
    assert_allclose(mixed.mean, given.mean, atol=1e-5)
    assert_allclose(mixed.log_probability, given.log_probability, atol=1e-5)


def test_a_heading_is_seen_beside_its_quarter_turns_and_no_others() -> None:
    torch.manual_seed(0)
    network, rng = FirstGuess(KINDS[1]), np.random.default_rng(2)
    points = torch.from_numpy(rng.normal(size=(1, 8, 30, FEATURES))).float().requires_grad_()
    network.heading(points, torch.ones(1, 8, 3))[0, 1, 0].backward()
    assert points.grad is not None
    assert points.grad[0].abs().sum(dim=(1, 2)).nonzero().ravel().tolist() == [1, 3, 5, 7]


def test_headings_are_sixteenths_of_a_turn_or_twice_or_four_times_as_many() -> None:
    with pytest.raises(PriorError, match="5"):
        FirstGuessConfig(headings=5)
    assert_allclose(np.diff(SMALL.at(0.3)), np.pi / 4)
