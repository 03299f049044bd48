from dataclasses import replace

import numpy as np
import pytest

from objgraph.training.code_search import CodeGaussian
from objgraph.training.fit import code_mixture
from tests.shapes import box_prior


def test_the_mixture_finds_kinds_of_shapes_and_their_spread():
    rng = np.random.default_rng(0)
    kinds = np.array([[4.0, 0.0, 0.0], [-4.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
    spread = np.array([0.3, 0.5, 0.2])
    codes = np.concatenate([kind + spread * rng.normal(size=(300, 3)) for kind in kinds])
    found = code_mixture(codes, 3)
    order = [int(np.linalg.norm(found.means - kind, axis=1).argmin()) for kind in kinds]
    np.testing.assert_allclose(found.means[order], kinds, atol=0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), spread, rtol=0.1)


def test_few_codes_are_one_gaussian():
    codes = np.random.default_rng(1).normal(size=(15, 3))
    found = code_mixture(codes, 256)
    np.testing.assert_allclose(found.means, codes.mean(axis=0)[None])


def test_a_code_is_held_to_the_nearest_mean():
    covariance = np.diag([1.0, 0.01, 1.0])
    means = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 0.0]])
    gaussian = CodeGaussian.of(replace(box_prior(), code_means=means, code_covariance=covariance))
    # nearer to the first by its length, to the second by its deviations
    np.testing.assert_allclose(gaussian.offset(np.array([[0.2, 0.9, 0.0]])), [[-1.8, -0.1, 0.0]])


def test_random_codes_lie_about_all_means():
    means = np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]])
    prior = replace(box_prior(), code_means=means, code_covariance=0.04 * np.eye(3))
    codes = prior.draw_codes(2000, np.random.default_rng(2), within=2.0)
    right = codes[:, 0] > 0
    assert right.mean() == pytest.approx(0.5, abs=0.05)
    assert np.abs(codes[right] - means[0]).max() <= 0.4 + 1e-9
    # of a normal distribution cut at two deviations
    assert codes[right, 1].std() == pytest.approx(0.2 * 0.88, rel=0.06)
