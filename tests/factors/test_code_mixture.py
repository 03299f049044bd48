import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.code_mixture import code_mixture
from factors.errors import FactorError
from factors.priors import code_prior
from factors.state import ObjectKeys

KEYS = ObjectKeys.numbered(1)


def values_of(code: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEYS.code, code)
    return values


def drawn(seed: int, components: int, length: int):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(length, length))
    return (
        rng.normal(size=(components, length)),
        root @ root.T + 0.1 * np.eye(length),
        rng.normal(size=length),
    )


@given(seed=st.integers(0, 10**6), components=st.integers(1, 6), length=st.integers(1, 5))
def test_the_loss_is_that_of_the_likeliest_component(seed, components, length):
    means, covariance, code = drawn(seed, components, length)
    alone = [code_prior(KEYS, mean, covariance).error(values_of(code)) for mean in means]
    assert code_mixture(KEYS, means, covariance).error(values_of(code)) == pytest.approx(min(alone))


def test_the_gradient_is_the_losss():
    means, covariance, code = drawn(3, 4, 5)
    factor = code_mixture(KEYS, means, covariance)
    A, b = factor.linearize(values_of(code)).jacobian()
    step = 1e-5 * np.eye(5)
    numeric = [(factor.error(values_of(code + e)) - factor.error(values_of(code - e))) / 2e-5 for e in step]
    np.testing.assert_allclose(-A.T @ b, numeric, rtol=1e-5, atol=1e-6)


def test_an_optimiser_goes_to_the_component_that_a_measurement_chooses():
    means, covariance = np.array([[0.0, 0.0], [4.0, 0.0]]), 0.25 * np.eye(2)
    measured = gtsam.noiseModel.Isotropic.Sigma(2, 0.5)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(code_mixture(KEYS, means, covariance))
    graph.push_back(gtsam.PriorFactorVector(KEYS.code, np.array([4.5, 1.0]), measured))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values_of(np.array([0.0, 0.0]))).optimize()
    # both weigh the same: halfway between the measurement and the component next to it
    np.testing.assert_allclose(found.atVector(KEYS.code), [4.25, 0.5], atol=1e-6)


def test_what_is_no_mixture_is_refused():
    with pytest.raises(FactorError, match="of no one mixture"):
        code_mixture(KEYS, np.zeros((2, 3)), np.eye(2))
    with pytest.raises(FactorError, match="not positive definite"):
        code_mixture(KEYS, np.zeros((2, 2)), np.diag([1.0, -1.0]))
