"""What the factors of one view say, as one quadratic about a linearisation point."""

from collections.abc import Sequence

import gtsam
import numpy as np
import torch

from factors.base import ObservationFactor
from factors.errors import FactorError
from factors.reduce import Rows, guarded_factor, reduce_rows


def linearized(factors: Sequence[ObservationFactor], values: gtsam.Values) -> gtsam.LinearContainerFactor:
    """The factors' common quadratic at `values`: a plain C++ factor that never decodes again.

    The rows depend on where the object is in the camera's frame and not on where both are in the world, and GTSAM
    moves a linear factor by logarithms in the body frames: moving object and camera together leaves its error as it
    was, exactly, so that closing a loop does not make it stale. Only a change of the relative pose, the scale or the
    code does.

    Raises:
        FactorError: there is no factor, or they are not of the same variables.
    """
    if not factors or any(factor.keys != factors[0].keys for factor in factors):
        raise FactorError("only factors on the same variables, at least one, have a common quadratic")
    keys, dims = factors[0].keys, factors[0].dims
    rows = [factor.rows(values) for factor in factors]
    together = Rows(
        torch.cat([part.jacobian.cpu().double() for part in rows]),
        torch.cat([part.residual.cpu().double() for part in rows]),
        sum(part.loss for part in rows),
    )
    reduced = reduce_rows(together)
    splits = np.cumsum(dims)[:-1]
    factor = guarded_factor(
        keys,
        dims,
        len(reduced.residual),
        lambda values, jacobian: (reduced.residual, np.split(reduced.jacobian, splits, axis=1)),
        "linearized",
    )
    own = values.extract(gtsam.KeyVector(keys))
    return gtsam.LinearContainerFactor(factor.linearize(own), own)
