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
    moves a linear factor by logarithms in the body frames: where object and camera have moved together its error
    and its linearisation are what they were, exactly, so that closing a loop does not make it stale. Only a change of
    the relative pose, the scale or the code does. Steps from there are distorted by as much as both have moved:
    `carried_along` mends that without decoding.

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


def carried_along(
    quadratic: gtsam.LinearContainerFactor, point: gtsam.Values, values: gtsam.Values, pose: int, camera: int
) -> tuple[gtsam.LinearContainerFactor, gtsam.Values]:
    """The same quadratic about the place to which camera and object have gone, and its linearisation point.

    `point` is where it was linearised, `pose` and `camera` the keys of the object's pose and the camera's. The new
    point has the camera as in `values` and the object where it is if it has not moved in the camera's frame.
    """
    T_camera_object = point.atPose3(camera).between(point.atPose3(pose))
    moved = gtsam.Values(point)
    moved.update(camera, values.atPose3(camera))
    moved.update(pose, values.atPose3(camera).compose(T_camera_object))
    return gtsam.LinearContainerFactor(quadratic.factor(), moved), moved
