"""The paper's metrics of one reconstructed object against its ground truth."""

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float, Int

from objgraph.datasets.ground_truth import GroundTruth
from objgraph.geometry.boxes import box_iou
from objgraph.metrics.placed import PlacedMesh
from objgraph.metrics.pose import PoseError, pose_error
from objgraph.metrics.shape import surface_errors, volume_iou

TRANSLATION_LIMIT_M = 0.2
ROTATION_LIMIT_DEG = 20.0
SCALE_LIMIT_PCT = 20.0
IOU_LIMIT = 0.25
CHAMFER_LIMIT_M = 0.2


@dataclass(frozen=True)
class BoxEvaluation:
    """How well one object's box was found."""

    pose_correct: bool
    """Translation, rotation and mean scale are all within their limits."""
    translation_m: float
    """Distance of the centres of the two oriented boxes."""
    rotation_deg: float
    """Rotation error modulo the ground truth's symmetry about its y axis."""
    heading_error_deg: float
    """How far the object is turned about its up axis, after the symmetric turn that leaves the least."""
    scale_pct: float
    """Deviation from one of the mean ratio of metric extents, percent."""
    scale_pct_max: float
    """The same of the worst axis."""
    box_iou: float
    """Intersection over union of the oriented boxes; the boxes are not turned by the symmetry."""

    @property
    def iou_correct(self) -> bool:
        """The paper's IoU > 0.25, of oriented boxes."""
        return self.box_iou > IOU_LIMIT


@dataclass(frozen=True)
class Evaluation(BoxEvaluation):
    """How well one object was reconstructed."""

    volume_iou: float
    """Intersection over union of the solids; see `objgraph.metrics.shape.volume_iou`."""
    chamfer_m: float
    """Mean of the two directed mean distances, world frame, 10,000 points a side."""
    recall: float
    """Share of the true surface within 2 cm of the estimated one."""

    @property
    def chamfer_correct(self) -> bool:
        """The paper's CD < 0.2 m."""
        return self.chamfer_m < CHAMFER_LIMIT_M


def evaluate_box(estimate: PlacedMesh, truth: GroundTruth) -> BoxEvaluation:
    """Measure the box about an estimate.

    Raises `EvaluationError` where the truth cannot be measured (see `evaluate_object`).
    """
    target = PlacedMesh.of_truth(truth)
    pose = pose_error(estimate, target, truth.symmetry)
    return BoxEvaluation(
        pose_correct=_pose_correct(pose), box_iou=box_iou(estimate.box, target.box), **asdict(pose)
    )


def evaluate_object(
    T_world_object: Float[np.ndarray, "4 4"],
    scale: Float[np.ndarray, "3"],
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    truth: GroundTruth,
    seed: int = 0,
) -> Evaluation:
    """Measure an estimate: rigid pose, metres per canonical unit along the object's axes, canonical mesh.

    `seed` draws the points of the Chamfer distance. Raises `EvaluationError` where either side cannot be
    measured (empty, flat or non-finite mesh, non-rigid pose, negative symmetry).
    """
    estimate = PlacedMesh("the estimate", np.asarray(T_world_object), np.asarray(scale), vertices, faces)
    target = PlacedMesh.of_truth(truth)
    chamfer, recall = surface_errors(estimate, target, seed)
    return Evaluation(
        **asdict(evaluate_box(estimate, truth)),
        volume_iou=volume_iou(estimate, target),
        chamfer_m=chamfer,
        recall=recall,
    )


def _pose_correct(pose: PoseError) -> bool:
    return (
        pose.translation_m < TRANSLATION_LIMIT_M
        and pose.rotation_deg < ROTATION_LIMIT_DEG
        and pose.scale_pct < SCALE_LIMIT_PCT
    )
