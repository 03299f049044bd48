"""Depth images registered with each other, whole: no mask, object or prior takes part.

Every two frames that overlap are registered, and one pose graph holds all of them (Choi, Zhou & Koltun, "Robust
reconstruction of indoor scenes", CVPR 2015, as Open3D has it).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from objgraph.observation.frames import Frame

MAX_DEPTH = 3.5
"""Metres: beyond it structured light is off by more than what is measured here."""
OVERLAP = 0.35
"""Of the points of either frame, the share that must lie near the other's for the two to be registered."""
FINE = 0.04
"""Metres: largest distance of a correspondence in the end."""
_VOXEL, _STEEP = 0.02, 0.05
_COARSE_TO_FINE = ((0.08, 0.03), (FINE, 0.015))
"""Metres: largest distance of a correspondence, and of the robust kernel."""

Cloud = Any
"""`open3d.geometry.PointCloud` with normals, in the camera's frame."""


@dataclass(frozen=True)
class Pair:
    """Frame i in frame j, by registration."""

    i: int
    j: int
    T_j_i: Float[np.ndarray, "4 4"]


def cloud_of(frame: Frame) -> Cloud | None:
    """Its points in the camera within `MAX_DEPTH`, but those at the border of something: these are between surfaces.

    None where there is none.
    """
    import open3d as o3d  # slow

    known = np.isfinite(frame.depth) & (frame.depth > 0) & (frame.depth < MAX_DEPTH)
    slope = np.hypot(*np.gradient(np.where(known, frame.depth, np.nan)))
    v, u = np.nonzero(known & (slope < _STEEP))
    if not len(v):
        return None
    points = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(_VOXEL)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(4 * _VOXEL, 30))
    return cloud


def registered(
    i: int, j: int, clouds: Sequence[Cloud], T_world_camera: Float[np.ndarray, "n 4 4"]
) -> Pair | None:
    """Point-to-plane ICP with a robust kernel from the poses on; None where too little of either frame is in the other."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    T_j_i = np.linalg.inv(T_world_camera[j]) @ T_world_camera[i]
    for a, b, T in ((i, j, T_j_i), (j, i, np.linalg.inv(T_j_i))):
        if (
            registration.evaluate_registration(clouds[a], clouds[b], _COARSE_TO_FINE[0][0], T).fitness
            < OVERLAP
        ):
            return None
    for reach, kernel in _COARSE_TO_FINE:
        T_j_i = registration.registration_icp(
            clouds[i], clouds[j], reach, T_j_i,
            registration.TransformationEstimationPointToPlane(registration.TukeyLoss(kernel)),
            registration.ICPConvergenceCriteria(max_iteration=50),
        ).transformation  # fmt: skip
    return Pair(i, j, T_j_i)


def parts(count: int, pairs: Sequence[Pair]) -> Int[np.ndarray, "n"]:
    """A number for each frame, the same for those that pairs connect."""
    i, j = np.array([[pair.i, pair.j] for pair in pairs], dtype=int).reshape(-1, 2).T
    links = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    return connected_components(links, directed=False)[1]


def together(
    T_world_camera: Float[np.ndarray, "n 4 4"], clouds: Sequence[Cloud], pairs: Sequence[Pair]
) -> Float[np.ndarray, "n 4 4"]:
    """The poses that fit all pairs best, the first as it was given; pairs that fit badly are left out. All must be connected."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    graph = registration.PoseGraph()
    for pose in T_world_camera:
        graph.nodes.append(registration.PoseGraphNode(pose))
    for pair in pairs:
        information = registration.get_information_matrix_from_point_clouds(
            clouds[pair.i], clouds[pair.j], FINE, pair.T_j_i
        )
        loop = pair.j != pair.i + 1
        graph.edges.append(
            registration.PoseGraphEdge(pair.i, pair.j, pair.T_j_i, information, uncertain=loop)
        )
    option = registration.GlobalOptimizationOption(
        max_correspondence_distance=FINE, edge_prune_threshold=0.25, reference_node=0
    )
    # it warns where consecutive frames alone do not connect all
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        registration.global_optimization(
            graph,
            registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(),
            option,
        )
    poses = np.stack([node.pose for node in graph.nodes])
    return T_world_camera[0] @ np.linalg.inv(poses[0]) @ poses
