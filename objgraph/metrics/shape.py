"""Chamfer distance and the intersection over union of solids."""

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from objgraph.errors import EvaluationError
from objgraph.geometry.frames import transformed
from objgraph.metrics.placed import PlacedMesh

CHAMFER_POINTS = 10_000
"""Points sampled on each surface."""
RECALL_M = 0.02
"""A true surface that is farther from every estimated one is missing."""
VOXELS = 64
"""Voxels along the longest side of the ground truth's box."""
_MOST_VOXELS = 128
_PADDING = 2
_BLOCK = 4  # voxels a side that are ruled out together


def surface_errors(
    estimate: PlacedMesh, truth: PlacedMesh, seed: int = 0, points: int = CHAMFER_POINTS
) -> tuple[float, float]:
    """Chamfer distance, and the share of the true surface that the estimate's is within `RECALL_M` of.

    The former is the mean of the two directed mean distances between surfaces, in metres, in the world frame. Points
    are uniform by metric area and drawn independently on either side, so equal surfaces do not give zero but about
    half the mean spacing of the points: half a centimetre on a chair. Of the truth's those that are seen from outside count.
    """
    a, b = points_on(estimate, points, seed), seen_points_on(truth, points, seed + 1)
    of_estimate, of_truth = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
    return float((of_estimate.mean() + of_truth.mean()) / 2), float((of_truth < RECALL_M).mean())


def points_on(mesh: PlacedMesh, points: int, seed: int = 0) -> Float[np.ndarray, "n 3"]:
    """World points on the surface, uniform by area; raises EvaluationError where it has none."""
    return transformed(mesh.T_world_object, _drawn(mesh, _surface(mesh), points, seed))


def seen_points_on(mesh: PlacedMesh, points: int, seed: int = 0) -> Float[np.ndarray, "n 3"]:
    """The same, of what is seen from somewhere outside (`seen_from_outside`): so many, or as many as twice as many hold.

    Raises EvaluationError where it has no area, or nothing of it is seen.
    """
    from objgraph.geometry.raycaster import (
        seen_from_outside,
    )  # slow to import, and of no use to most commands

    surface = _surface(mesh)  # in the object's axes: the same points wherever it stands
    drawn = _drawn(mesh, surface, 2 * points, seed)
    seen = drawn[seen_from_outside([surface], drawn)]
    if not len(seen):
        raise EvaluationError(f"{mesh.label}: nothing of its surface is seen from outside")
    return transformed(mesh.T_world_object, seen[:points])


def _surface(mesh: PlacedMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.p_metric, mesh.faces, process=False)


def _drawn(mesh: PlacedMesh, surface: trimesh.Trimesh, points: int, seed: int) -> Float[np.ndarray, "n 3"]:
    if not surface.area > 0:
        raise EvaluationError(f"{mesh.label}: the mesh has no area to sample")
    return np.asarray(trimesh.sample.sample_surface(surface, points, seed=seed)[0])


def volume_iou(estimate: PlacedMesh, truth: PlacedMesh, voxels: int = VOXELS) -> float:
    """Intersection over union of the two solids, in [0, 1].

    Both meshes become solids the same way, which asks nothing of them (closed, oriented or free of
    overlaps): on one grid along the axes of the ground truth's box, of `voxels` cells along its longest side,
    a voxel is solid when its centre lies within half a voxel of the surface, or cannot be reached from
    outside without passing within half a voxel's diagonal of it. Single sheets are thus one voxel thick,
    gaps up to about a voxel are closed, and what lies behind a wider opening is outside.
    """
    T_truth_world = np.linalg.inv(truth.T_world_object)
    p_estimate = transformed(T_truth_world, estimate.p_world)
    used = p_estimate[np.unique(estimate.faces)]
    bounds = np.stack([used.min(axis=0), used.max(axis=0)])
    if (bounds[0] > truth.bounds_metric[1]).any() or (bounds[1] < truth.bounds_metric[0]).any():
        return 0.0
    low, high = np.minimum(bounds[0], truth.bounds_metric[0]), np.maximum(bounds[1], truth.bounds_metric[1])
    # a gigantic estimate coarsens the grid instead of exhausting the memory
    voxel = max(truth.extents.max() / voxels, (high - low).max() / _MOST_VOXELS)
    axes = _grid(low, high, truth.bounds_metric.mean(axis=0), voxel)
    a = _solidify(p_estimate, estimate.faces, axes, voxel)
    b = _solidify(truth.p_metric, truth.faces, axes, voxel)
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0


def _grid(low: np.ndarray, high: np.ndarray, origin: np.ndarray, voxel: float) -> list[np.ndarray]:
    """Cell centres an axis; laid out from the origin, so that they do not move with the estimate."""
    first = np.floor((low - origin) / voxel).astype(int) - _PADDING
    last = np.ceil((high - origin) / voxel).astype(int) + _PADDING
    return [origin[i] + voxel * np.arange(first[i], last[i] + 1) for i in range(3)]


def _solidify(
    vertices: np.ndarray, faces: np.ndarray, axes: list[np.ndarray], voxel: float
) -> Bool[np.ndarray, "x y z"]:
    distance = _distance_near_surface(vertices, faces, axes, voxel)
    surface = distance <= voxel / 2
    sealed = distance <= voxel * np.sqrt(3) / 2
    corner = np.zeros(distance.shape, dtype=bool)
    corner[0, 0, 0] = True
    open_space = ndimage.binary_propagation(corner, mask=~sealed)
    # give back the voxels that the seal, wider than the surface, took from the outside
    given_back = ndimage.binary_dilation(open_space, iterations=2, mask=sealed & ~surface)
    return ~np.logical_or(open_space, given_back)


def _distance_near_surface(
    vertices: np.ndarray, faces: np.ndarray, axes: list[np.ndarray], voxel: float
) -> Float[np.ndarray, "x y z"]:
    """Distances of the voxels' centres; infinite for blocks wholly farther off than half a voxel's diagonal."""
    from objgraph.geometry.raycaster import raycaster  # slow to import, and of no use to most commands

    scene = raycaster([(vertices, faces)])

    def distances(points: Float[np.ndarray, "... 3"]) -> np.ndarray:
        return scene.compute_distance(np.ascontiguousarray(points)).numpy()

    coarse = [axis[0] + voxel * (np.arange(0, len(axis), _BLOCK) + (_BLOCK - 1) / 2) for axis in axes]
    near = distances(_points(coarse)) <= 1.01 * voxel * _BLOCK * np.sqrt(3) / 2
    shape = tuple(len(axis) for axis in axes)
    for i in range(3):
        near = near.repeat(_BLOCK, axis=i)
    near = near[: shape[0], : shape[1], : shape[2]]
    distance = np.full(shape, np.inf)
    distance[near] = distances(_points(axes)[near])
    return distance


def _points(axes: list[np.ndarray]) -> Float[np.ndarray, "x y z 3"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
