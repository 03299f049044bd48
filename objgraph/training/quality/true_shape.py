"""A mesh as the truth that a reconstruction is measured against, in the canonical frame, and the measures."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from objgraph.errors import EvaluationError
from objgraph.geometry.raycaster import raycaster, seen_from_outside
from objgraph.priors.mesh import field_grid
from objgraph.training.meshes.files import canonical, read_mesh
from objgraph.training.meshes.samples import surface_points
from objgraph.training.meshes.solid import SHEET_HALF_THICKNESS, Solid, SolidDistance, solidify

EXACT_POINTS = 30_000
"""Points a side whose distances to the other surface are measured."""
PAIR_POINTS = 20_000
"""Points a side of the point-to-point Chamfer distance."""
NEAR = 0.02
"""A surface point this close to the other surface is recalled, or precise."""


@dataclass(frozen=True)
class ShapeScore:
    """A reconstruction against the truth, in diagonals of the true box."""

    chamfer: float
    """Mean of the two directed mean distances from points on one surface to the other surface."""
    chamfer_points: float
    """The same between two sets of 20,000 points: equal surfaces give about 0.003."""
    recall: float
    """Share of the true surface within 0.02 of the reconstruction."""
    precision: float
    """Share of the reconstructed surface within 0.02 of the truth."""


class TrueShape:
    """A solid, points on what is seen of its surface from somewhere outside, and distances to all of its outer surface."""

    def __init__(self, solid: Solid, seed: int = 0) -> None:
        self.solid = solid
        self.signed_distance = SolidDistance(solid)
        rng = np.random.default_rng(seed)
        outer = surface_points(solid, self.signed_distance, 2 * EXACT_POINTS, rng, area_power=1.0)
        seen = np.flatnonzero(seen_from_outside(solid.surfaces, outer))
        if len(seen) == 0:
            raise EvaluationError(f"{solid.name}: nothing of its surface is seen from outside")
        self.points = outer[rng.choice(seen, EXACT_POINTS, replace=len(seen) < EXACT_POINTS)]
        self._seed = seed

    @cached_property
    def extents(self) -> Float[np.ndarray, "3"]:
        """Of the bounding box, whose diagonal is 1."""
        bounds = np.array([mesh.bounds for mesh in self.solid.surfaces])
        return bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)

    def score(self, mesh: trimesh.Trimesh) -> ShapeScore:
        """Measure a reconstruction; nothing is removed from it first.

        Raises:
            EvaluationError: it has no area.
        """
        if not mesh.area > 0:
            raise EvaluationError(f"{self.solid.name}: the reconstruction has no area to sample")
        drawn = trimesh.sample.sample_surface(mesh, EXACT_POINTS, seed=self._seed + 1)[0]
        missed = _unsigned([mesh], self.points)
        added = self.distance(drawn)
        # either set is in random order already
        truth, other = self.points[:PAIR_POINTS], np.asarray(drawn)[:PAIR_POINTS]
        pairs = cKDTree(truth).query(other)[0].mean() + cKDTree(other).query(truth)[0].mean()
        return ShapeScore(
            chamfer=float(missed.mean() + added.mean()) / 2,
            chamfer_points=float(pairs) / 2,
            recall=float(np.mean(missed < NEAR)),
            precision=float(np.mean(added < NEAR)),
        )

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Unsigned distance to the outer surface; exact outside.

        Inside overlapping parts it is a lower bound: the nearest face there may be within another part.
        """
        nearest = _unsigned(self.solid.surfaces, points)
        signed = self.signed_distance(points)
        return np.where(signed < -SHEET_HALF_THICKNESS, np.maximum(nearest, -signed), nearest)

    def inside(
        self, resolution: int, bound: float, stretch: Float[np.ndarray, "3"]
    ) -> Bool[np.ndarray, "g g g"]:
        """Which nodes of `objgraph.priors.mesh.extract_mesh`'s grid, multiplied by `stretch`, are inside the solid."""
        # a shell's distance jumps where it closes a hole, so that no value there rules out a block
        slope = np.inf if self.solid.shells else 1.01 * stretch.max()
        half = self.extents / 2 + 2 * SHEET_HALF_THICKNESS

        def field(nodes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
            points = nodes * stretch
            value = np.linalg.norm(np.maximum(np.abs(points) - half, 0.0), axis=1)
            boxed = value == 0
            value[boxed] = self.signed_distance(points[boxed])
            return value

        return field_grid(field, resolution, bound, slope=float(slope)) < 0


def volume_iou(a: Bool[np.ndarray, "x y z"], b: Bool[np.ndarray, "x y z"]) -> float:
    """Intersection over union of two solids given at the nodes of one grid; 0 where both are empty."""
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0


def read_solid(path: Path, name: str) -> Solid:
    """A mesh file as a solid, centred on its bounding box and scaled to a diagonal of 1.

    Its axes are taken to be the canonical ones: y up, front at -z. Colours and textures are dropped.

    Raises:
        PriorError: the file cannot be read, holds no faces, or cannot be closed.
    """
    return solidify(canonical(read_mesh(path), name), name)


def _unsigned(meshes: Sequence[trimesh.Trimesh], points: np.ndarray) -> np.ndarray:
    scene = raycaster((mesh.vertices, mesh.faces) for mesh in meshes)
    return scene.compute_distance(np.ascontiguousarray(points, np.float32)).numpy().astype(float)
