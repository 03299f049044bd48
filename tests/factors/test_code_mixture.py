import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.code_mixture import OTHERS, CodeKinds, code_mixture
from factors.errors import FactorError
from factors.state import ObjectKeys

KEYS = ObjectKeys.numbered(1)


def values_of(code: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEYS.code, code)
    return values


def drawn(seed: int, components: int, length: int):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(2, length, length))
    narrow, wide = 0.1 * roots @ roots.transpose(0, 2, 1) + np.array([0.1, 2.0])[:, None, None] * np.eye(
        length
    )
    kinds = CodeKinds(rng.normal(size=(components, length)), narrow)
    return kinds, rng.normal(size=length), wide, rng.normal(size=length) * rng.choice([1, 5])


@given(seed=st.integers(0, 10**6), components=st.integers(1, 6), length=st.integers(1, 5))
def test_the_loss_is_the_negative_log_density_of_the_likeliest_component(seed, components, length):
    kinds, mean, wide, code = drawn(seed, components, length)
    factor = code_mixture(KEYS, kinds, mean, wide)

    def density(m, covariance, z):
        off = z - m
        return -0.5 * (off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(2 * np.pi * covariance)[1])

    def likeliest(z):
        kind = [density(m, kinds.covariance, z) for m in kinds.means]
        return max(
            np.log((1 - OTHERS) / components) + max(kind),
            np.log(OTHERS) + density(mean, wide, z),
        )

    peak = max(likeliest(kinds.means[0]), likeliest(mean))
    assert factor.error(values_of(code)) == pytest.approx(peak - likeliest(code), abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_the_gradient_is_the_losss(seed):
    kinds, mean, wide, code = drawn(seed, 4, 5)
    factor = code_mixture(KEYS, kinds, mean, wide)
    A, b = factor.linearize(values_of(code)).jacobian()
    step = 1e-5 * np.eye(5)
    numeric = [(factor.error(values_of(code + e)) - factor.error(values_of(code - e))) / 2e-5 for e in step]
    np.testing.assert_allclose(-A.T @ b, numeric, rtol=1e-5, atol=1e-6)


def optimum(start: list[float], measured: list[float], sigma: float) -> np.ndarray:
    kinds = CodeKinds(np.array([[0.0, 0.0], [4.0, 0.0]]), 0.25 * np.eye(2))
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(code_mixture(KEYS, kinds, np.zeros(2), 100.0 * np.eye(2)))
    noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    graph.push_back(gtsam.PriorFactorVector(KEYS.code, np.array(measured), noise))
    return gtsam.LevenbergMarquardtOptimizer(graph, values_of(np.array(start))).optimize().atVector(KEYS.code)


def test_an_optimiser_goes_to_the_kind_that_a_measurement_chooses():
    # both weigh the same: halfway between the measurement and the mean next to it
    np.testing.assert_allclose(optimum([0.0, 0.0], [4.5, 1.0], 0.5), [4.25, 0.5], atol=1e-6)


def test_a_shape_of_no_kind_is_let_be():
    # only N(0, 100 I) holds it: 1 part in 10,001
    np.testing.assert_allclose(optimum([0.0, 0.0], [0.0, 9.0], 0.1), [0.0, 9.0], atol=2e-3)


def test_what_is_no_mixture_is_refused():
    with pytest.raises(FactorError, match="of no one mixture"):
        code_mixture(KEYS, CodeKinds(np.zeros((2, 3)), np.eye(3)), np.zeros(2), np.eye(2))
    with pytest.raises(FactorError, match="not of codes of length"):
        code_mixture(KEYS, CodeKinds(np.zeros((2, 3)), np.eye(2)), np.zeros(3), np.eye(3))
    with pytest.raises(FactorError, match="not positive definite"):
        code_mixture(KEYS, CodeKinds(np.zeros((2, 2)), np.diag([1.0, -1.0])), np.zeros(2), np.eye(2))
