"""A canonical mesh at its pose and size in the world: what every metric compares."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from objgraph.datasets.ground_truth import GroundTruth
from objgraph.errors import EvaluationError
from objgraph.geometry.boxes import OrientedBox
from objgraph.geometry.frames import is_rigid, transformed


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh with p_world = T_world_object (scale * p_object).

    Raises `EvaluationError`, naming `label`, when the pose is not rigid, the scale not positive, or the mesh
    empty, flat, not finite, or indexed beyond its vertices.
    """

    label: str
    T_world_object: Float[np.ndarray, "4 4"]
    scale: Float[np.ndarray, "3"]
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    def __post_init__(self) -> None:
        _check_pose(self.label, self.T_world_object, self.scale)
        _check_mesh(self.label, self.vertices, self.faces)

    @staticmethod
    def of_truth(truth: GroundTruth) -> "PlacedMesh":
        return PlacedMesh("the ground truth", truth.T_world_object, truth.scale, truth.vertices, truth.faces)

    @cached_property
    def p_metric(self) -> Float[np.ndarray, "v 3"]:
        """Vertices in the object's axes, in metres."""
        return np.asarray(self.scale) * np.asarray(self.vertices, dtype=float)

    @cached_property
    def p_world(self) -> Float[np.ndarray, "v 3"]:
        """Vertices in the world frame, in metres."""
        return transformed(self.T_world_object, self.p_metric)

    @cached_property
    def bounds_metric(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the surface in the object's axes, in metres."""
        used = self.p_metric[np.unique(self.faces)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @property
    def extents(self) -> Float[np.ndarray, "3"]:
        """Sizes of the bounding box along the object's axes, in metres."""
        return self.bounds_metric[1] - self.bounds_metric[0]

    @property
    def centre_world(self) -> Float[np.ndarray, "3"]:
        """Centre of the oriented bounding box in the world frame."""
        return self.T_world_object[:3, :3] @ self.bounds_metric.mean(axis=0) + self.T_world_object[:3, 3]

    @property
    def box(self) -> OrientedBox:
        """The oriented bounding box in the world frame."""
        return OrientedBox(self.centre_world, self.T_world_object[:3, :3], self.extents)


def _check_pose(label: str, T: np.ndarray, scale: np.ndarray) -> None:
    if np.shape(T) != (4, 4) or not np.isfinite(T).all():
        raise EvaluationError(f"{label}: T_world_object must be a finite 4x4 matrix, got shape {np.shape(T)}")
    if not is_rigid(T):
        raise EvaluationError(f"{label}: T_world_object is not rigid; take the scale out of it")
    if np.shape(scale) != (3,) or not np.isfinite(scale).all() or np.min(scale) <= 0:
        raise EvaluationError(f"{label}: the scale must be three positive numbers, got {scale}")


def _check_mesh(label: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    if len(vertices) == 0 or len(faces) == 0:
        raise EvaluationError(f"{label}: the mesh is empty; a failed reconstruction counts as a failure")
    if np.shape(vertices)[1:] != (3,) or np.shape(faces)[1:] != (3,):
        raise EvaluationError(
            f"{label}: vertices and faces must be (n, 3), got {np.shape(vertices)} and {np.shape(faces)}"
        )
    if np.min(faces) < 0 or np.max(faces) >= len(vertices):
        raise EvaluationError(f"{label}: a face names a vertex beyond the mesh's {len(vertices)}")
    used = np.asarray(vertices)[np.unique(faces)]
    if not np.isfinite(used).all():
        raise EvaluationError(f"{label}: the mesh has vertices that are not finite")
    size = np.ptp(used, axis=0)
    if size.min() <= 1e-9 * max(size.max(), 1e-300):
        raise EvaluationError(f"{label}: the mesh is flat, its box measures {size}")
