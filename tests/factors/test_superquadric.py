"""The superquadric against closed forms and numerical derivatives."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import FactorError
from factors.superquadric import SEMI_AXIS, Superquadric, SuperquadricConfig

ELLIPSOID, BOX, CYLINDER = (-30.0, -30.0, 0.0), (30.0, 30.0, 0.0), (-30.0, 30.0, 0.0)
codes = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-2, 2))


@pytest.fixture
def decoder() -> Superquadric:
    return Superquadric().double()


def at(decoder: Superquadric, points, code) -> np.ndarray:
    points, code = torch.as_tensor(np.array(points)), torch.as_tensor(np.array([code]))
    return decoder(points, code).numpy()


def test_an_ellipsoid_is_an_exact_sphere(decoder):
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 3))
    expected = np.linalg.norm(points, axis=1) - SEMI_AXIS
    np.testing.assert_allclose(at(decoder, points, ELLIPSOID), expected, atol=2e-6)


def test_the_faces_of_a_box_are_at_their_distance():
    decoder = Superquadric(SuperquadricConfig(squarest=200.0)).double()
    for axis in range(3):
        points = np.random.default_rng(axis).uniform(-0.5, 0.5, (50, 3)) * SEMI_AXIS
        points[:, axis] = np.linspace(0.6, 2, 50) * SEMI_AXIS
        expected = points[:, axis] - SEMI_AXIS
        np.testing.assert_allclose(at(decoder, points, BOX), expected, atol=2e-3)
        np.testing.assert_allclose(at(decoder, -points, BOX), expected, atol=2e-3)


def test_a_cylinder_stands_upright():
    decoder = Superquadric(SuperquadricConfig(squarest=200.0)).double()
    angle = np.linspace(0, 6, 40)
    side = SEMI_AXIS * np.stack([np.cos(angle), np.linspace(-0.8, 0.8, 40), np.sin(angle)], axis=1)
    np.testing.assert_allclose(at(decoder, side, CYLINDER), 0, atol=2e-3)
    lid = side * [0.7, 0, 0.7] + [0, SEMI_AXIS, 0]
    np.testing.assert_allclose(at(decoder, lid, CYLINDER), 0, atol=2e-3)


def test_a_tapered_tube_is_as_wide_as_its_height_says():
    """Between the bottom and the top the width changes along a line, beyond them it stays; round in x and z."""
    config = SuperquadricConfig(squarest=200.0)
    decoder, share = Superquadric(config).double(), config.taper * np.tanh(0.7)
    height, angle = np.linspace(-0.9, 0.9, 19), np.linspace(0, 6, 19)
    width = 1 + share * height
    side = SEMI_AXIS * np.stack([width * np.cos(angle), height, width * np.sin(angle)], axis=1)
    np.testing.assert_allclose(at(decoder, side, (-30.0, 30.0, 0.7)), 0, atol=2e-3)
    for beyond in (-1.5, 1.5):
        width = 1 + share * np.sign(beyond)
        aside = SEMI_AXIS * np.array([[3 * width, beyond, 0.0], [0.0, beyond, 3 * width]])
        np.testing.assert_allclose(at(decoder, aside, (-30.0, 30.0, 0.7)), 2 * SEMI_AXIS, atol=2e-3)


@given(code=codes, seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_jacobian_is_that_of_differences(code, seed):
    decoder = Superquadric().double()
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.6, 0.6, (6, 3))
    # the taper has a kink at the height of the top and of the bottom
    points = points[np.abs(np.abs(points[:, 1]) - SEMI_AXIS) > 1e-4]
    jet = decoder.linearize(torch.as_tensor(points), torch.tensor([code], dtype=torch.float64))
    np.testing.assert_allclose(jet.value.numpy(), at(decoder, points, code))
    h = 1e-6
    for k, step in enumerate(h * np.eye(3)):
        d_point = (at(decoder, points + step, code) - at(decoder, points - step, code)) / (2 * h)
        d_code = (at(decoder, points, code + step) - at(decoder, points, code - step)) / (2 * h)
        np.testing.assert_allclose(jet.d_point[:, k].numpy(), d_point, atol=2e-6)
        np.testing.assert_allclose(jet.d_code[:, k].numpy(), d_code, atol=2e-6)


def test_the_middle_and_far_away_are_finite_in_single_precision():
    points = torch.tensor([[0.0, 0, 0], [1e-9, 0, 0], [0, 0.2, 0], [100.0, -100, 100], [0, 1e3, 0]])
    for code in (ELLIPSOID, BOX, CYLINDER, (0.0, 0.0, 5.0), (0.0, 0.0, -5.0)):
        jet = Superquadric().linearize(points, torch.tensor([code]))
        assert all(torch.isfinite(part).all() for part in jet)
        assert (jet.value[:2] < -0.25).all()
        assert (jet.value[3:] > 50).all()


def test_owner_tells_shapes_apart(decoder):
    points, both = torch.randn(6, 3).double(), torch.tensor([ELLIPSOID, (1.0, -1.0, 0.5)]).double()
    owner = torch.tensor([0, 1, 1, 0, 0, 1])
    together = decoder.linearize(points, both, owner)
    for shape in (0, 1):
        alone = decoder.linearize(points[owner == shape], both[shape : shape + 1])
        for a, b in zip(together, alone, strict=True):
            torch.testing.assert_close(a[owner == shape], b)
    with pytest.raises(FactorError, match="owner"):
        decoder(points, both)
    with pytest.raises(FactorError, match=r"takes \(b, 3\)"):
        decoder(points, both[:, :2])
