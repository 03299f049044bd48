"""Many rows -> square-root rows and a slack, and the guard between them and GTSAM."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors.errors import FactorError, NotFiniteError
from factors.keys import readable_key

Evaluate = Callable[[gtsam.Values, bool], tuple[np.ndarray, Sequence[np.ndarray] | None]]
"""(values, want Jacobians) -> residual and one Jacobian block a key."""


class Rows(NamedTuple):
    """A loss and the rows that have its gradient: J^T r = dloss/dx, J^T J a curvature that is positive semi-definite."""

    jacobian: Float[Tensor, "m d"]
    residual: Float[Tensor, "m"]
    loss: float


class ReducedRows(NamedTuple):
    """Rows of the same normal equations, as many as there are unknowns, and one slack entry."""

    jacobian: Float[np.ndarray, "d+1 d"]
    residual: Float[np.ndarray, "d+1"]


def reduce_rows(rows: Rows) -> ReducedRows:
    """Compress m rows to d + 1 with the same J^T J and J^T r, and half a squared norm that is the loss.

    QR of [J | r] in float64 (normal equations would square the condition number). The last entry has no
    Jacobian: it carries what of the loss the quadratic does not show. Raises FactorError where the loss is
    smaller than the quadratic's own value, which no sum of squares and no majorised score can be.
    """
    stacked = torch.cat([rows.jacobian, rows.residual[:, None]], dim=1).to("cpu", torch.float64)
    dof = stacked.shape[1] - 1
    triangle = np.zeros((dof + 1, dof + 1))
    upper = torch.linalg.qr(stacked, mode="r").R.numpy()
    triangle[: len(upper)] = upper
    jacobian, residual = np.zeros((dof + 1, dof)), np.zeros(dof + 1)
    jacobian[:dof], residual[:dof] = triangle[:dof, :dof], triangle[:dof, dof]
    rest = 2.0 * rows.loss - residual @ residual
    if rest < -1e-6 * (1.0 + abs(rows.loss)):
        raise FactorError(f"the loss {rows.loss:.6g} is below its quadratic's value by {-rest / 2:.3g}")
    residual[dof] = np.sqrt(max(rest, 0.0))
    return ReducedRows(jacobian, residual)


def guarded_factor(
    keys: Sequence[int],
    dims: Sequence[int],
    rows: int,
    evaluate: Evaluate,
    name: str,
) -> gtsam.CustomFactor:
    """A `gtsam.CustomFactor` of unit noise that checks whatever it hands over.

    A wrong row count is a segmentation fault in GTSAM, a wrong column count is accepted in silence and a NaN
    makes an optimiser return its start: here each raises FactorError with the factor's name and keys.
    """
    keys = list(keys)
    label = f"{name}({', '.join(readable_key(key) for key in keys)})"

    def error_function(this: gtsam.CustomFactor, values: gtsam.Values, H: list | None) -> np.ndarray:
        residual, blocks = evaluate(values, H is not None)
        _check(residual, (rows,), f"{label}: the residual")
        if H is not None:
            if blocks is None or len(blocks) != len(keys):
                raise FactorError(f"{label}: {len(keys)} Jacobian blocks are due, one a key")
            for i, (key, dim, block) in enumerate(zip(keys, dims, blocks, strict=True)):
                what = f"{label}: the Jacobian w.r.t. {readable_key(key)}"
                _check(block, (rows, dim), what)
                H[i] = np.asfortranarray(block)
        return residual

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), gtsam.KeyVector(keys), error_function)


def _check(array: np.ndarray, shape: tuple[int, ...], what: str) -> None:
    if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != np.float64:
        found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise FactorError(f"{what} is {found}, not float64 {shape}")
    if not np.isfinite(array).all():
        raise NotFiniteError(
            f"{what} has {np.count_nonzero(~np.isfinite(array))} entries that are not finite"
        )
