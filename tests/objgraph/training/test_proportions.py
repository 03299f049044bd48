"""What codes say of their shapes' proportions, from shapes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from objgraph.training.codes.proportions import FEWEST, fit_proportions

BOX = np.array([0.6, 0.5, 0.4])


def drawn(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Codes of unequal variances, extents of which the first entry tells the depth to .05, and the codes' covariance."""
    rng = np.random.default_rng(seed)
    deviation = np.array([2.0, 0.5, 1.0, 0.1])
    codes = rng.normal(0.3, 1, (count, 4)) * deviation
    u = np.outer(codes[:, 0], [0.0, 0.0, 0.4]) + rng.normal(0, 0.05, (count, 3))
    return codes, BOX * np.exp(u), np.diag(deviation**2)


def test_what_the_code_says_is_found_and_what_it_does_not_is_left_over():
    codes, extents, covariance = drawn(400)
    found = fit_proportions(codes, extents, BOX, covariance)
    assert found is not None
    assert_allclose(found.slope[:, 0], [0, 0, 0.4], atol=0.01)
    assert_allclose(np.sqrt(np.diag(found.covariance)), np.hypot(0.05, 0.05), rtol=0.1)
    other, edges, _ = drawn(2000, seed=1)
    off = np.log(edges / BOX) - found.of(other)
    assert_allclose(np.sqrt(np.mean(off**2, axis=0)), 0.05, rtol=0.1)


def test_codes_that_say_nothing_leave_all_of_it_over():
    rng = np.random.default_rng(2)
    extents = BOX * np.exp(rng.normal(0, 0.3, (200, 3)))
    found = fit_proportions(rng.normal(size=(200, 30)), extents, BOX, np.eye(30))
    assert found is not None
    assert_allclose(np.sqrt(np.diag(found.covariance)), 0.3, rtol=0.25)


def test_a_generators_many_shapes_do_not_outweigh_what_people_made():
    codes, extents, covariance = drawn(600)
    rng = np.random.default_rng(3)
    own = np.arange(600) < 60
    extents[own] = BOX * np.exp(rng.normal(0.1, 0.3, (60, 3)))
    sources = [f"author {i}" if by_people else "generator" for i, by_people in enumerate(own)]
    found = fit_proportions(codes, extents, BOX, covariance, sources)
    assert found is not None
    # 60 and 10 count, the former with a deviation of .3; of the depth the codes say nothing for most
    assert_allclose(np.sqrt(np.diag(found.covariance))[:2], 0.3 * np.sqrt(60 / 70), rtol=0.2)
    assert np.abs(found.slope[2, 0]) < 0.2
    alike = fit_proportions(codes, extents, BOX, covariance)
    assert alike is not None
    assert (np.diag(alike.covariance) < 0.5 * np.diag(found.covariance)).all()
    same = fit_proportions(codes, extents, BOX, covariance, ["generator"] * 600)
    assert same is not None
    assert_allclose(same.slope, alike.slope)


@pytest.mark.parametrize(("count", "enough"), [(FEWEST - 1, False), (FEWEST, True)])
def test_of_few_shapes_nothing_is_said(count, enough):
    assert (fit_proportions(*drawn(count)[:2], BOX, np.eye(4)) is not None) == enough
