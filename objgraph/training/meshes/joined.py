"""Shapes in one piece: loose parts are joined to the rest by stems, and narrow gaps and necks are filled.

Castors, slats and arm rests of collected meshes are often held by next to nothing, and a decoder makes of that nothing.
"""

from dataclasses import replace

import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from objgraph.errors import SolveError
from objgraph.priors.mesh import field_grid, mesh_of_grid
from objgraph.training.meshes.solid import Solid, SolidDistance

WHOLE = 0.98
"""Share of its surface that the largest piece of a shape in one piece has at least."""
RESOLUTION = 96
"""Cells an axis in which shapes are looked at."""
_BOUND = 0.55
_BALL = 0.015
"""Radius of the ball that gets in wherever nothing is filled, canonical units: some 1.5 cm on a chair."""
_BENEATH = 0.003
"""How far the filling stays beneath the surface that is there, so that it leaves that as it is."""
_STEM_RADIUS = 0.008
_STEM_OVERLAP = 0.012
"""How far a stem goes into what it joins."""
_WIDEST_GAP = 0.06
_LEAST_SHARE = 5e-4
"""Of the surface; what is smaller is left as it is."""


def pieces(mesh: trimesh.Trimesh) -> tuple[Int[np.ndarray, "f"], Float[np.ndarray, "p"]]:
    """The piece of every face, and each piece's share of the surface."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    return labels, area / area.sum()


def joined(solid: Solid) -> Solid:
    """The solid with stems between its pieces where gaps are small, and filled where no ball gets in from outside.

    The latter is the morphological closing (Serra, "Image Analysis and Mathematical Morphology", 1982).
    """
    return _filled(_stemmed(solid))


def _filled(solid: Solid) -> Solid:
    distance, h = SolidDistance(solid), 2 * _BOUND / RESOLUTION
    # exact as far as the ball reaches, and two cells farther
    slope = 1.0 + (_BALL + 2 * h) / (np.sqrt(3) * h)
    grid = field_grid(lambda p: distance(p).astype(float), RESOLUTION, _BOUND, slope=slope)
    # where the ball's middle can come to from outside: cavities are filled too
    regions = np.empty(grid.shape, np.int32)
    ndimage.label(grid >= _BALL, output=regions)
    reached = regions != regions[0, 0, 0]
    if not (reached & (grid > _BENEATH)).any():
        return solid
    level = mesh_of_grid(np.where(reached & (grid >= _BALL), -h, grid - _BALL), _BOUND, remove_floaters=False)
    closing = np.where(reached, -h, grid)
    near = reached & (ndimage.distance_transform_edt(reached, sampling=h) < _BALL + 3 * h)  # pyright: ignore[reportOperatorIssue]
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.asarray(level.vertices, np.float32), np.asarray(level.faces, np.uint32))
    nodes = (np.argwhere(near) * h - _BOUND).astype(np.float32)
    closing[near] = _BALL + _BENEATH - scene.compute_distance(o3d.core.Tensor(nodes)).numpy()
    if not ((closing < 0) & (grid > _BENEATH)).any():
        return solid
    return replace(solid, closed=(*solid.closed, mesh_of_grid(closing, _BOUND, remove_floaters=False)))


def _stemmed(solid: Solid) -> Solid:
    distance = SolidDistance(solid)
    grid = field_grid(lambda p: distance(p).astype(float), RESOLUTION, _BOUND, slope=1.2)
    try:
        mesh = mesh_of_grid(grid, _BOUND, remove_floaters=False)
    except SolveError:
        return solid  # thinner than a cell all over
    labels, share = pieces(mesh)
    if share.max() >= WHOLE:
        return solid
    points = [np.unique(mesh.faces[labels == i]) for i in range(len(share))]
    order = np.argsort(-share)
    held, left = (
        np.asarray(mesh.vertices[points[order[0]]]),
        [i for i in order[1:] if share[i] > _LEAST_SHARE],
    )
    stems = []
    while left:
        tree = cKDTree(held)
        gaps = [tree.query(mesh.vertices[points[i]]) for i in left]
        nearest = int(np.argmin([gap.min() for gap, _ in gaps]))
        gap, at = gaps[nearest]
        if gap.min() > _WIDEST_GAP:
            break
        own = np.asarray(mesh.vertices[points[left.pop(nearest)]])
        stems.append(_stem(held[at[gap.argmin()]], own[gap.argmin()]))
        held = np.concatenate([held, own])
    return replace(solid, closed=(*solid.closed, *stems))


def _stem(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    segment = np.stack([start - _STEM_OVERLAP * along, end + _STEM_OVERLAP * along])
    return trimesh.creation.cylinder(_STEM_RADIUS, segment=segment, sections=8)
