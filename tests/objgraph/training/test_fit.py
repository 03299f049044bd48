from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.code_mixture import OTHERS, CodeKinds, code_mixture
from factors.state import ObjectKeys
from objgraph.training.code_search import CodePrior
from tests.shapes import box_prior

KINDS = CodeKinds(np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 0.0]]), np.diag([0.2, 0.01, 0.1]))
KEYS = ObjectKeys.numbered(1)


@pytest.mark.parametrize("kinds", [None, KINDS])
def test_a_search_holds_codes_to_what_the_graph_holds_them_to(kinds):
    prior = replace(box_prior(), kinds=kinds)
    codes = np.random.default_rng(0).normal(size=(40, 3))
    codes[:10] = KINDS.means[1] + 0.1 * codes[:10]
    cost, pull, information = CodePrior(prior).at(codes)
    for i, code in enumerate(codes):
        values = gtsam.Values()
        values.insert(KEYS.code, code)
        alone = CodeKinds(prior.code_mean[None], prior.code_covariance)
        factor = code_mixture(KEYS, prior.kinds or alone, prior.code_mean, prior.code_covariance)
        assert cost[i] / 2 == pytest.approx(factor.error(values), rel=1e-5, abs=1e-5)
        A, b = factor.linearize(values).jacobian()
        np.testing.assert_allclose(pull[i], -A.T @ b, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(information[i], A.T @ A, rtol=1e-5, atol=1e-6)


def test_random_codes_lie_about_the_kinds_but_for_a_few():
    means = np.array([[30.0, 0.0, 0.0], [-30.0, 0.0, 0.0]])
    prior = replace(box_prior(), kinds=CodeKinds(means, 0.04 * np.eye(3)))
    codes = prior.draw_codes(20_000, np.random.default_rng(2), within=2.0)
    right, other = codes[:, 0] > 20, np.abs(codes[:, 0]) < 20
    assert other.mean() == pytest.approx(OTHERS, abs=0.003)
    assert right.mean() == pytest.approx(0.5, abs=0.02)
    assert np.abs(codes[right] - means[0]).max() <= 0.4 + 1e-9
    # of a normal distribution cut at two deviations
    assert codes[right, 1].std() == pytest.approx(0.2 * 0.88, rel=0.02)
    assert codes[other, 1].std() == pytest.approx(np.sqrt(0.5) * 0.88, rel=0.15)
