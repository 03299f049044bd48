"""An object's covariance in other coordinates: the world's axes, and the paper's vector."""

import gtsam
import numpy as np
from jaxtyping import Float

from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.labelled import LabelledCovariance, ObjectCovariance, object_axes

WORLD_AXES = (
    *(f"rotation_{axis} [rad, world frame, about the object's origin]" for axis in "xyz"),
    *(f"translation_{axis} [m, world frame]" for axis in "xyz"),
)
XI_AXES = (
    *(f"t_{axis} [m, world frame]" for axis in "xyz"),
    *(f"phi_{axis} [rad, rotation vector of R_world_object]" for axis in "xyz"),
    *(f"s_{axis} [m per canonical unit, object axis]" for axis in "xyz"),
)


def in_world(covariance: ObjectCovariance, R_world_object: gtsam.Rot3) -> LabelledCovariance:
    """Rotation and translation along the world's axes; log-scale and code stay as they are."""
    turn = np.eye(len(covariance.matrix))
    turn[:3, :3] = turn[3:6, 3:6] = R_world_object.matrix()
    return covariance.mapped(turn, (*WORLD_AXES, *covariance.axes[6:]))


def of_xi(covariance: ObjectCovariance, state: ObjectState) -> LabelledCovariance:
    """Of `state.xi_world_object`, the paper's [t, phi, s] (eq:9dof_lie_algebra) read object to world, then the code.

    The rotation vector has no derivative at half a turn, where its covariance is not to be used.
    """
    rotation = state.T_world_object.rotation()
    jacobian = np.eye(len(covariance.matrix))
    jacobian[:RIGID_DOF, :RIGID_DOF] = 0.0
    jacobian[0:3, 3:6] = rotation.matrix()
    jacobian[3:6, 0:3] = _log_derivative(gtsam.Rot3.Logmap(rotation))
    jacobian[6:9, 6:9] = np.diag(state.scale)
    code = object_axes(len(covariance.matrix) - RIGID_DOF)[RIGID_DOF:]
    return covariance.mapped(jacobian, (*XI_AXES, *code))


def _log_derivative(phi: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """d Log(Exp(phi) Exp(w)) / dw at zero: the inverse of SO(3)'s right Jacobian (Chirikjian, 2011)."""
    angle = np.linalg.norm(phi)
    cross = np.array([[0, -phi[2], phi[1]], [phi[2], 0, -phi[0]], [-phi[1], phi[0], 0]])
    if angle < 1e-4:
        return np.eye(3) + cross / 2 + cross @ cross / 12
    rest = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    return np.eye(3) + cross / 2 + rest * cross @ cross
