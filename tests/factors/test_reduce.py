import gtsam
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from factors.errors import FactorError
from factors.reduce import Rows, guarded_factor, reduce_rows


@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(1, 8), st.floats(0, 10))
def test_reduction_keeps_the_normal_equations_and_the_loss(seed, m, dof, excess):
    generator = torch.Generator().manual_seed(seed)
    jacobian = torch.randn(m, dof, generator=generator, dtype=torch.float64)
    residual = torch.randn(m, generator=generator, dtype=torch.float64)
    loss = 0.5 * float(residual @ residual) + excess
    reduced = reduce_rows(Rows(jacobian, residual, loss))
    assert reduced.jacobian.shape == (dof + 1, dof)
    np.testing.assert_allclose(reduced.jacobian.T @ reduced.jacobian, jacobian.T @ jacobian, atol=1e-9)
    np.testing.assert_allclose(reduced.jacobian.T @ reduced.residual, jacobian.T @ residual, atol=1e-9)
    assert 0.5 * reduced.residual @ reduced.residual == pytest.approx(loss, rel=1e-9, abs=1e-9)


def test_a_loss_below_its_quadratic_is_refused():
    with pytest.raises(FactorError, match="below its quadratic"):
        reduce_rows(Rows(torch.eye(2).double(), torch.ones(2).double(), 0.1))


BAD = {
    "row count": (np.zeros(2), [np.zeros((3, 2))], r"F\(a0\): the residual is float64 \(2,\)"),
    "column count": (np.zeros(3), [np.zeros((3, 1))], r"Jacobian w.r.t. a0 is float64 \(3, 1\)"),
    "block count": (np.zeros(3), [], "1 Jacobian blocks are due"),
    "missing": (np.zeros(3), None, "1 Jacobian blocks are due"),
    "not finite": (np.array([0, np.nan, 0]), [np.zeros((3, 2))], "1 entries that are not finite"),
    "infinite Jacobian": (np.zeros(3), [np.full((3, 2), np.inf)], "6 entries that are not finite"),
    "single precision": (np.zeros(3, np.float32), [np.zeros((3, 2))], "float32"),
}


@pytest.mark.parametrize(("residual", "blocks", "message"), BAD.values(), ids=BAD.keys())
def test_what_would_crash_gtsam_is_an_error_that_names_the_keys(residual, blocks, message):
    key = gtsam.symbol("a", 0)
    factor = guarded_factor([key], [2], 3, lambda values, jacobian: (residual, blocks), "F")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(factor)
    values.insert(key, np.zeros(2))
    with pytest.raises(FactorError, match=message):
        graph.linearize(values)
