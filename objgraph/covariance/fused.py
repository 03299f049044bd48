"""Two estimates of the same object as one."""

from dataclasses import replace

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import POSE_DOF, RIGID_DOF, ObjectState
from objgraph.covariance.labelled import ObjectCovariance, of_one_object
from objgraph.covariance.quantile import squared_limit
from objgraph.errors import CovarianceError

_AGREEING = 1 - 1e-6
"""Share of two consistent estimates that are no further apart than those that are fused."""
_TOO_SURE = 3.0
"""Standard deviations are too small by about as much: marginals do not know what the prior cannot make."""


def fused(
    first: tuple[ObjectState, ObjectCovariance],
    second: tuple[ObjectState, ObjectCovariance],
    share: float = 0.5,
) -> tuple[ObjectState, ObjectCovariance]:
    """Covariance intersection (Julier & Uhlmann, 1997) of two estimates from the same data.

    Their errors go together by nobody knows how much: information is shared out, not added, so the result is
    consistent where both are. `share` is the first one's. Centres are compared along the world's axes, rotations in the tangent
    at the first one.

    Raises:
        CovarianceError: `share` is not between 0 and 1, the codes are of different decoders, a covariance is not
            positive definite, or the estimates contradict each other: their rotations or their
            centres are much further apart than both covariances allow, however their errors go together.
    """
    if not 0 < checks.number("the first estimate's share", share, error=CovarianceError) < 1:
        raise CovarianceError(f"the first estimate's share must be between 0 and 1, not {share}")
    for each in (first, second):
        if not isinstance(each, tuple) or len(each) != 2:
            raise CovarianceError(
                f"an estimate must be a state and its covariance, not a {type(each).__name__}"
            )
        checks.instance("the state of an estimate", each[0], ObjectState, CovarianceError)
        checks.instance("the covariance of an estimate", each[1], ObjectCovariance, CovarianceError)
    (state, a), (other, b) = first, second
    if len(a.matrix) != len(b.matrix) or len(state.code) != len(other.code):
        raise CovarianceError("estimates of different decoders cannot be fused")
    for each in (first, second):
        of_one_object(*each)
    for name, each in (("first", a), ("second", b)):
        checks.covariance(f"the {name} estimate's covariance", each.matrix, None, CovarianceError)
    R, other_R = state.T_world_object.rotation(), other.T_world_object.rotation()
    centre = state.T_world_object.translation()
    turn = gtsam.Rot3.Logmap(R.between(other_R))
    difference = state.local_coordinates(other)
    difference[:POSE_DOF] = *turn, *(other.T_world_object.translation() - centre)
    of_first = _carried(a.matrix, np.eye(3), R.matrix())
    of_other = _carried(b.matrix, gtsam.Rot3.LogmapDerivative(turn), other_R.matrix())
    _require_agreement(difference, of_first, of_other)
    matrix, gain = intersection(of_first, of_other, share)
    step = gain @ difference
    R_fused = R.compose(gtsam.Rot3.Expmap(step[:3]))
    pose = gtsam.Pose3(R_fused, centre + step[3:POSE_DOF])
    fused_state = replace(
        state,
        T_world_object=pose,
        log_scale=state.log_scale + step[POSE_DOF:RIGID_DOF],
        code=state.code + step[RIGID_DOF:],
    )
    matrix = _carried(matrix, gtsam.Rot3.ExpmapDerivative(step[:3]), R_fused.matrix().T)
    return fused_state, ObjectCovariance.of(matrix, "fused", a.subject)


def intersection(
    a: Float[np.ndarray, "d d"], b: Float[np.ndarray, "d d"], share: float = 0.5
) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, "d d"]]:
    """Of two covariances in one tangent: their intersection, and what it makes of the second's difference from the first."""
    of_a, of_b = share * np.linalg.inv(a), (1 - share) * np.linalg.inv(b)
    matrix = np.linalg.inv(of_a + of_b)
    matrix = 0.5 * (matrix + matrix.T)
    return matrix, matrix @ of_b


def _require_agreement(
    difference: Float[np.ndarray, "d"], a: Float[np.ndarray, "d d"], b: Float[np.ndarray, "d d"]
) -> None:
    """Whatever errors have in common, the covariance of two estimates' difference is at most 2 (A + B)."""
    for what, rows in (("rotations", slice(0, 3)), ("centres", slice(3, POSE_DOF))):
        apart = difference[rows]
        squared = apart @ np.linalg.solve(2 * _TOO_SURE**2 * (a + b)[rows, rows], apart)
        if squared > squared_limit(_AGREEING, 3):
            raise CovarianceError(
                f"the estimates contradict each other: their {what} are {np.linalg.norm(apart):.2g} "
                f"{'rad' if what == 'rotations' else 'm'} apart, far more than both covariances allow"
            )


def _carried(
    matrix: Float[np.ndarray, "d d"],
    of_rotation: Float[np.ndarray, "3 3"],
    of_centre: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "d d"]:
    """To other coordinates of the rotation and the centre."""
    J = np.eye(len(matrix))
    J[:3, :3], J[3:POSE_DOF, 3:POSE_DOF] = of_rotation, of_centre
    return J @ matrix @ J.T
