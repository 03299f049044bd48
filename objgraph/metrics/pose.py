"""9-DoF pose errors: box centres, rotation modulo symmetry, metric extents."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objgraph.errors import EvaluationError
from objgraph.metrics.placed import PlacedMesh

CONTINUOUS = 0
"""The symmetry class of objects that look the same turned by any angle about their y axis."""


@dataclass(frozen=True)
class PoseError:
    """Errors of one estimated 9-DoF pose."""

    translation_m: float
    """Distance of the centres of the two oriented boxes."""
    rotation_deg: float
    """Angle between the two frames, the smallest over the rotations that the symmetry class allows."""
    heading_error_deg: float
    """How far the estimate is then turned about its up axis; 0 for the continuous class."""
    scale_pct: float
    """Deviation from one of the mean, over the three axes, of the ratio of metric extents, in percent."""
    scale_pct_max: float
    """The same of the worst single axis."""


def pose_error(estimate: PlacedMesh, truth: PlacedMesh, symmetry: int = 1) -> PoseError:
    """Errors of `estimate` against `truth`: Scan2CAD's (Avetisyan et al., CVPR 2019), on metric extents.

    `symmetry` counts the rotations about y that leave the true object the same; 0 for all.
    """
    R = truth.T_world_object[:3, :3].T @ estimate.T_world_object[:3, :3]
    rotation, yaw = rotation_error(R, symmetry)
    ratio = align_extents(estimate.extents, yaw, symmetry) / truth.extents
    return PoseError(
        translation_m=float(np.linalg.norm(estimate.centre_world - truth.centre_world)),
        rotation_deg=float(np.rad2deg(rotation)),
        heading_error_deg=float(np.rad2deg(abs(_yaw(rotation_y(-yaw) @ R)))),
        scale_pct=float(100 * abs(ratio.mean() - 1)),
        scale_pct_max=float(100 * np.abs(ratio - 1).max()),
    )


def rotation_error(R_truth_estimate: Float[np.ndarray, "3 3"], symmetry: int) -> tuple[float, float]:
    """The angle left, in radians, and the symmetric rotation about y, in radians, that leaves the least.

    For the continuous class the angle left is the one between the two y axes.
    """
    yaws = _symmetric_yaws(R_truth_estimate, symmetry)
    angles = [_angle(rotation_y(-yaw) @ R_truth_estimate) for yaw in yaws]
    best = int(np.argmin(angles))
    return angles[best], yaws[best]


def _symmetric_yaws(R: np.ndarray, symmetry: int) -> list[float]:
    if symmetry == CONTINUOUS:
        return [_yaw(R)]
    if symmetry < 0:
        raise EvaluationError(f"a symmetry is a number of turns, or 0 for every angle, not {symmetry}")
    return [2 * np.pi * k / symmetry for k in range(symmetry)]


def align_extents(extents: Float[np.ndarray, "3"], yaw: float, symmetry: int) -> Float[np.ndarray, "3"]:
    """Extents along the axes of the object turned by `yaw`, which leaves it the same: where that is a quarter turn, of an
    object that was stretched a little, x and z change places."""
    quarter_turn = symmetry % 4 == 0 and abs(np.sin(yaw)) > abs(np.cos(yaw))
    return extents[[2, 1, 0]] if quarter_turn else extents


def rotation_y(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _yaw(R: Float[np.ndarray, "3 3"]) -> float:
    """The rotation about y that is nearest: it maximises the trace of Ry(-yaw) R."""
    return float(np.arctan2(R[0, 2] - R[2, 0], R[0, 0] + R[2, 2]))


def _angle(R: Float[np.ndarray, "3 3"]) -> float:
    # atan2 keeps its accuracy near 0 and pi, where arccos of the trace loses half the digits
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(skew), np.trace(R) - 1))
