"""The joint covariance of some variables of a Bayes tree."""

from collections.abc import Sequence

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.linalg import null_space, solve_triangular


def joint_covariance(tree: gtsam.ISAM2, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
    """Joint marginal covariance of `keys`, in their order; raises RuntimeError where the tree does not determine them.

    GTSAM's own takes what is held exactly (`NonlinearEquality`, a constrained noise model) for known to within 1, or all
    of a variable for held where a part of it is; here each direction is what it is.
    """
    joint = tree.joint(gtsam.KeyVector([*keys]))
    point = tree.getLinearizationPoint()
    dims = [point.extract(gtsam.KeyVector([key])).dim() for key in keys]
    columns = dict(zip(keys, np.split(np.arange(sum(dims)), np.cumsum(dims)[:-1]), strict=True))
    rows, exact = [], []
    for i in range(joint.size()):
        factor = joint.at(i)
        own, model = list(factor.keys()), factor.get_model()
        A, _ = factor.jacobian()  # whitened, but for the exact rows
        row = np.zeros((len(A), sum(dims)))
        row[:, np.concatenate([columns[key] for key in own])] = A
        rows.append(row)
        exact.append(np.zeros(len(A), bool) if model is None else model.sigmas() == 0)
    A, held = np.concatenate(rows), np.concatenate(exact)
    free = null_space(A[held]) if held.any() else np.eye(A.shape[1])
    R = np.linalg.qr(A[~held] @ free, mode="r")
    if len(R) < free.shape[1] or not np.diag(R).all():
        raise RuntimeError("indeterminant linear system")
    spread = solve_triangular(R.T, free.T, lower=True).T
    return spread @ spread.T
