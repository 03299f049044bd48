"""Camera poses from whole depth images alone: a reference where a data set's own poses are another reconstruction's.

Every two frames that overlap are registered (point-to-plane ICP with a robust kernel), and one pose graph holds all
of them (Choi, Zhou & Koltun, "Robust reconstruction of indoor scenes", CVPR 2015, as Open3D has it). No mask, no object
and no prior takes part. How far the registrations disagree with the poses that they give says how much these can tell.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from jaxtyping import Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from objgraph.errors import EvaluationError
from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Frame

_registration = o3d.pipelines.registration

MAX_DEPTH = 3.5
"""Metres: beyond it structured light is off by more than what is measured here."""
OVERLAP = 0.35
"""Of the points of either frame, the share that must lie near the other's for the two to be registered."""
AHEAD = 2.0
"""Metres before a camera at which two of its poses are compared: an error of rotation counts by what it moves there."""
_VOXEL, _STEEP = 0.02, 0.05
_COARSE_TO_FINE = ((0.08, 0.03), (0.04, 0.015))
"""Metres: largest distance of a correspondence, and of the robust kernel."""


@dataclass(frozen=True)
class DenseReference:
    """Poses by registration of depth images with each other; the first is as it was given."""

    T_world_camera: Float[np.ndarray, "n 4 4"]
    pairs: int
    """Frames registered with each other."""
    spread_m: float
    """Median distance by which a registration and the poses disagree about what is 2 m ahead."""
    given_spread_m: float
    """The same of the poses that were given."""


@dataclass(frozen=True)
class _Pair:
    """Frame i in frame j."""

    i: int
    j: int
    T_j_i: Float[np.ndarray, "4 4"]
    information: Float[np.ndarray, "6 6"]


def dense_reference(
    frames: Sequence[Frame], progress: Callable[[int, int], None] | None = None
) -> DenseReference:
    """Register all frames that overlap, beginning at their own poses.

    Raises:
        EvaluationError: frames that overlap do not connect all with the first, so the poses of some are unknown.
    """
    clouds = [_cloud(frame) for frame in frames]
    given = np.stack([np.asarray(frame.T_world_camera, float) for frame in frames])
    pairs: list[_Pair] = []
    for i in range(len(frames)):
        later = (_pair(i, j, clouds, given) for j in range(i + 1, len(frames)))
        pairs += [pair for pair in later if pair is not None]
        if progress is not None:
            progress(i + 1, len(frames))
    if apart := _apart(len(frames), pairs):
        names = ", ".join(frames[k].name for k in apart)
        raise EvaluationError(
            f"frames {names} are not connected with the first by frames that overlap: take more, or leave these out"
        )
    poses = _together(given, pairs)
    return DenseReference(poses, len(pairs), _spread(poses, pairs), _spread(given, pairs))


def _apart(count: int, pairs: Sequence[_Pair]) -> list[int]:
    """The frames that no way leads to from the first."""
    i, j = np.array([[pair.i, pair.j] for pair in pairs], dtype=int).reshape(-1, 2).T
    _, part = connected_components(
        coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count)), directed=False
    )
    return np.flatnonzero(part != part[0]).tolist()


def _pair(
    i: int, j: int, clouds: Sequence[o3d.geometry.PointCloud], given: Float[np.ndarray, "n 4 4"]
) -> _Pair | None:
    """None where too little of either frame is in the other."""
    start = np.linalg.inv(given[j]) @ given[i]
    shares = (_overlap(clouds[i], clouds[j], start), _overlap(clouds[j], clouds[i], np.linalg.inv(start)))
    if min(shares) < OVERLAP:
        return None
    T_j_i = _registered(clouds[i], clouds[j], start)
    information = _registration.get_information_matrix_from_point_clouds(
        clouds[i], clouds[j], _COARSE_TO_FINE[-1][0], T_j_i
    )
    return _Pair(i, j, T_j_i, information)


def _together(given: Float[np.ndarray, "n 4 4"], pairs: Sequence[_Pair]) -> Float[np.ndarray, "n 4 4"]:
    """The poses that fit all pairs best, the first as it was given; pairs that fit badly are left out."""
    graph = _registration.PoseGraph()
    for pose in given:
        graph.nodes.append(_registration.PoseGraphNode(pose))
    for pair in pairs:
        loop = pair.j != pair.i + 1
        graph.edges.append(
            _registration.PoseGraphEdge(pair.i, pair.j, pair.T_j_i, pair.information, uncertain=loop)
        )
    _registration.global_optimization(
        graph,
        _registration.GlobalOptimizationLevenbergMarquardt(),
        _registration.GlobalOptimizationConvergenceCriteria(),
        _registration.GlobalOptimizationOption(
            max_correspondence_distance=_COARSE_TO_FINE[-1][0], edge_prune_threshold=0.25, reference_node=0
        ),
    )
    poses = np.stack([node.pose for node in graph.nodes])
    return given[0] @ np.linalg.inv(poses[0]) @ poses


def _cloud(frame: Frame) -> o3d.geometry.PointCloud:
    """Its points in the camera, but those at the border of something: these are between surfaces."""
    known = np.isfinite(frame.depth) & (frame.depth > 0) & (frame.depth < MAX_DEPTH)
    slope = np.hypot(*np.gradient(np.where(known, frame.depth, np.nan)))
    v, u = np.nonzero(known & (slope < _STEEP))
    points = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(_VOXEL)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(4 * _VOXEL, 30))
    return cloud


def _overlap(
    a: o3d.geometry.PointCloud, b: o3d.geometry.PointCloud, T_b_a: Float[np.ndarray, "4 4"]
) -> float:
    """Share of the points of `a` near one of `b`."""
    return _registration.evaluate_registration(a, b, _COARSE_TO_FINE[0][0], T_b_a).fitness


def _registered(
    a: o3d.geometry.PointCloud, b: o3d.geometry.PointCloud, T_b_a: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "4 4"]:
    for reach, kernel in _COARSE_TO_FINE:
        T_b_a = _registration.registration_icp(
            a, b, reach, T_b_a,
            _registration.TransformationEstimationPointToPlane(_registration.TukeyLoss(kernel)),
            _registration.ICPConvergenceCriteria(max_iteration=50),
        ).transformation  # fmt: skip
    return T_b_a


def _spread(poses: Float[np.ndarray, "n 4 4"], pairs: Sequence[_Pair]) -> float:
    ahead = np.array([[0.0, 0.0, AHEAD]])
    off = [
        transformed(np.linalg.inv(poses[pair.i]) @ poses[pair.j] @ pair.T_j_i, ahead) - ahead
        for pair in pairs
    ]
    return float(np.median(np.linalg.norm(off, axis=-1)))
