"""Rays cast at some meshes."""

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Bool, Float

Raycaster: TypeAlias = o3d.t.geometry.RaycastingScene
_DIRECTIONS = 100
"""From which surfaces are looked at from afar, spread evenly."""
_STEP = 1e-3
"""Off the surface, of the diagonal, where a look at it ends."""


def raycaster(meshes: Iterable[tuple[np.ndarray, np.ndarray]]) -> Raycaster:
    """Of vertices and faces; one thread, so that it may be used in many processes."""
    scene = Raycaster(nthreads=1)
    for vertices, faces in meshes:
        scene.add_triangles(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32))
    return scene


def seen_from_outside(
    surfaces: Sequence[trimesh.Trimesh], points: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Which points on the surfaces are in view from at least one of a hundred directions.

    As in DeepSDF (Park et al., CVPR 2019), whose shapes are looked at by a hundred cameras: half of the surface of an infinigen bed
    lies between mattress, blanket and frame, where no camera sees it.
    """
    bounds = np.array([mesh.bounds for mesh in surfaces])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    middle, step = (low + high) / 2, _STEP * np.linalg.norm(high - low)
    # about the middle: rays are single precision's
    scene = raycaster((mesh.vertices - middle, mesh.faces) for mesh in surfaces)
    # a Fibonacci lattice on the sphere
    index = np.arange(_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * index / _DIRECTIONS, np.pi * (1 + np.sqrt(5)) * index
    level = np.sqrt(1 - z**2)
    hidden = np.arange(len(points))
    for direction in np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1):
        start = points[hidden] - middle + step * direction
        rays = np.concatenate([start, np.broadcast_to(direction, start.shape)], axis=1).astype(np.float32)
        hidden = hidden[scene.test_occlusions(o3d.core.Tensor(rays)).numpy()]
    return ~np.isin(np.arange(len(points)), hidden)
