"""Errors of an estimated box in the coordinates of its covariance, modulo the true object's symmetry."""

from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from objgraph.covariance.box import BoxPose
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.metrics.placed import PlacedMesh
from objgraph.metrics.pose import CONTINUOUS, align_extents, rotation_error, rotation_y


@dataclass(frozen=True)
class BoxError:
    """What leads from an estimated box to the true one."""

    tangent: Float[np.ndarray, "9"]
    """Over `BOX_AXES`: rotation (rad) and centre (m) in the estimate's frame, logarithms of the extents' ratios."""


def box_error(box: BoxPose, truth: GroundTruth) -> BoxError:
    """The true box, turned by the symmetry that brings it nearest, in the tangent at the estimated one.

    An object that looks the same from all sides has no heading: its error about y is zero.

    Raises:
        EvaluationError: the ground truth is no mesh, its pose no pose, or its symmetry negative.
    """
    placed = PlacedMesh.of_truth(truth)
    R_world_box = box.T_world_box.rotation().matrix()
    R_truth_estimate = placed.T_world_object[:3, :3].T @ R_world_box
    _, yaw = rotation_error(R_truth_estimate, truth.symmetry)
    R_world_truth = placed.T_world_object[:3, :3] @ rotation_y(yaw)
    R = R_world_box.T @ R_world_truth
    rotation = gtsam.Rot3.Logmap(gtsam.Rot3(R))
    if truth.symmetry == CONTINUOUS:
        rotation[1] = 0.0
    centre = R_world_box.T @ (placed.centre_world - box.T_world_box.translation())
    extents = np.log(align_extents(placed.extents, yaw, truth.symmetry) / box.extents)
    return BoxError(np.concatenate([rotation, centre, extents]))


def corners_m(box: BoxPose, error: BoxError) -> float:
    """Mean distance of an estimated box's corners from those of the true one: all nine degrees of freedom in metres."""
    corner = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(8, 3) * box.extents
    R = gtsam.Rot3.Expmap(error.tangent[:3]).matrix()
    true = (corner * np.exp(error.tangent[6:])) @ R.T + error.tangent[3:6]
    return float(np.linalg.norm(true - corner, axis=1).mean())
