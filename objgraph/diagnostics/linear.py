"""GTSAM's linear graphs as arrays; the columns of sorted keys follow each other."""

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_matrix


def tangent_dims(linear: gtsam.GaussianFactorGraph) -> dict[int, int]:
    """Dimension of every variable of `linear`, by sorted key."""
    zero = linear.gradientAtZero()
    return {key: zero.at(key).size for key in sorted(linear.keyVector())}


def sparse_jacobian(linear: gtsam.GaussianFactorGraph, dims: dict[int, int]) -> csc_matrix:
    """The whitened Jacobian; `dims` as from `tangent_dims`."""
    row, column, value = linear.sparseJacobian_()  # counted from 1; the last column is the right-hand side
    row, column, total = row.astype(int) - 1, column.astype(int) - 1, sum(dims.values())
    left = column < total
    shape = int(row.max(initial=0)) + 1, total
    return csc_matrix((value[left], (row[left], column[left])), shape=shape)


def hessian_diagonal(linear: gtsam.GaussianFactorGraph) -> dict[int, Float[np.ndarray, "d"]]:
    """Squared norms of the Jacobian's columns, by key."""
    dims = tangent_dims(linear)
    _, column, value = linear.sparseJacobian_()
    total = sum(dims.values())
    diagonal = np.bincount(column.astype(int) - 1, value**2, minlength=total + 1)[:total]
    return dict(zip(dims, np.split(diagonal, np.cumsum([*dims.values()])[:-1]), strict=True))
