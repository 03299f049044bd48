"""An object's covariance in other coordinates: the world's axes, and the paper's vector."""

import gtsam
import numpy as np

from factors import checks
from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.box import BOX_AXES
from objgraph.covariance.labelled import (
    POSE_AXES,
    LabelledCovariance,
    ObjectCovariance,
    object_axes,
    of_one_object,
)  # fmt: skip
from objgraph.errors import CovarianceError

WORLD_AXES = (
    *(f"rotation_{axis} [rad, world frame, about the object's origin]" for axis in "xyz"),
    *(f"translation_{axis} [m, world frame]" for axis in "xyz"),
)
BOX_WORLD_AXES = (
    *(f"rotation_{axis} [rad, world frame, about the box's centre]" for axis in "xyz"),
    *(f"centre_{axis} [m, world frame]" for axis in "xyz"),
)
XI_AXES = (
    *(f"t_{axis} [m, world frame]" for axis in "xyz"),
    *(f"phi_{axis} [rad, rotation vector of R_world_object]" for axis in "xyz"),
    *(f"s_{axis} [m per canonical unit, object axis]" for axis in "xyz"),
)


def in_world(covariance: LabelledCovariance, R_world_object: gtsam.Rot3) -> LabelledCovariance:
    """An object's covariance, or its box's, with rotation and place along the world's axes; the rest stays as it is.

    Raises:
        CovarianceError: it is neither's, or the rotation is none.
    """
    checks.instance("covariance", covariance, LabelledCovariance, CovarianceError)
    checks.instance("R_world_object", R_world_object, gtsam.Rot3, CovarianceError)
    there = {POSE_AXES: WORLD_AXES, BOX_AXES[:6]: BOX_WORLD_AXES}.get(covariance.axes[:6])
    if there is None:
        raise CovarianceError(f"a covariance over {covariance.axes[:6]} is neither an object's nor a box's")
    turn = np.eye(len(covariance.matrix))
    turn[:3, :3] = turn[3:6, 3:6] = R_world_object.matrix()
    return covariance.mapped(turn, (*there, *covariance.axes[6:]))


def of_xi(covariance: ObjectCovariance, state: ObjectState) -> LabelledCovariance:
    """Of `state.xi_world_object`, the paper's [t, phi, s] (eq:9dof_lie_algebra) read object to world, then the code.

    The rotation vector has no derivative at half a turn, where its covariance is not to be used.
    """
    of_one_object(state, covariance)
    rotation = state.T_world_object.rotation()
    jacobian = np.eye(len(covariance.matrix))
    jacobian[:RIGID_DOF, :RIGID_DOF] = 0.0
    jacobian[0:3, 3:6] = rotation.matrix()
    jacobian[3:6, 0:3] = gtsam.Rot3.LogmapDerivative(gtsam.Rot3.Logmap(rotation))
    jacobian[6:9, 6:9] = np.diag(state.scale)
    code = object_axes(len(covariance.matrix) - RIGID_DOF)[RIGID_DOF:]
    return covariance.mapped(jacobian, (*XI_AXES, *code))
