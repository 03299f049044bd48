"""Which turns about its up axis leave a shape the same."""

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.geometry.raycaster import raycaster

SAME = 0.02
"""Gap, in diagonals of the shape's box, below which a turn leaves it the same."""
_SHARE = 98
"""Per cent of the surface that is within the gap: a handle or a back's slats make a front."""
_POINTS = 3000
"""Drawn on the surface."""


def turn_gaps(mesh: trimesh.Trimesh, angles: Float[np.ndarray, "a"]) -> Float[np.ndarray, "a"]:
    """How far a mesh's surface is from itself turned about y by each of the angles (radians), in diagonals of its box."""
    scene = raycaster([(mesh.vertices, mesh.faces)])
    points = np.asarray(trimesh.sample.sample_surface(mesh, _POINTS, seed=0)[0])
    gaps = []
    for angle in angles:
        turn = trimesh.transformations.rotation_matrix(angle, [0, 1, 0])[:3, :3]
        gap = scene.compute_distance((points @ turn.T).astype(np.float32)).numpy()
        gaps.append(np.percentile(gap, _SHARE))
    return np.array(gaps) / np.linalg.norm(mesh.extents)
