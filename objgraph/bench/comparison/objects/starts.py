"""Where methods begin: at the best of our initialisation, which all can share, or where each would by itself."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import gtsam
import numpy as np
import open3d as o3d
import trimesh
from jaxtyping import Float

from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectState
from objgraph.bench.comparison.contenders.methods import StartKind
from objgraph.bench.comparison.objects.config import ComparisonConfig
from objgraph.errors import InitialisationError
from objgraph.geometry.frames import transformed_back
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import first_states
from objgraph.observation.gravity_box import gravity_box, smallest_heading
from objgraph.observation.sampling import ObjectView
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior

_HEADINGS = 8
_POINTS = 3000
_REACH_M = 0.3
"""Correspondences of the ICP are no longer than this."""
_CUT_M = 0.15
"""Distances of points count as this at most when headings are compared."""


@dataclass(frozen=True)
class Start:
    """First states, the likeliest first, and the processor seconds that they took."""

    states: tuple[ObjectState, ...]
    seconds: float
    chances: tuple[float, ...] = ()
    """How likely each is by the prior's first guess; empty where it has none."""

    def first(self) -> "Start":
        """The likeliest alone."""
        return Start(self.states[:1], self.seconds)


def find_start(
    kind: StartKind,
    prior: ShapePrior,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    config: ComparisonConfig,
) -> Start:
    """A method's first states, of which there is one but for "best"; only that is told where the floor is.

    Raises:
        InitialisationError: there are too few points, or no guess can be solved.
    """
    begun = time.process_time()
    if kind == "best":
        builder = ObjectBuilder(config.graph, up_world, floor)
        found = first_states(prior, views, builder, config.initialisation)
        return Start(found.states, time.process_time() - begun, found.chances)
    state = mean_shape_by_icp(prior, views, up_world, one_scale=kind == "icp-7dof")
    return Start((state,), time.process_time() - begun)


def mean_shape_by_icp(
    prior: ShapePrior,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"],
    one_scale: bool = False,
) -> ObjectState:
    """The mean shape (the paper's z = 0) matched to the points by ICP from several headings about gravity (paper, III-E).

    Its size is the category's mean, or with `one_scale` that at which its box is as large as that of the points, as a
    7-DoF pose (DSP-SLAM) has it; the paper does not say how it starts its three scales.

    Raises:
        InitialisationError: there are too few points.
    """
    points = np.concatenate([view.points_world for view in views]) if views else np.zeros((0, 3))
    if len(points) < 10:
        raise InitialisationError(f"{len(points)} points are too few to place an object; add views of it")
    shape = _mean_shape(prior.decoder, tuple(prior.code_mean.tolist()))
    extents = np.ptp(shape, axis=0)
    tree = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    found: list[tuple[float, ObjectState]] = []
    for k in range(_HEADINGS):
        box = gravity_box(points, up_world, smallest_heading(points, up_world) + 2 * np.pi * k / _HEADINGS)
        size = prior.size_mean
        if one_scale:
            size = float(np.linalg.norm(box.size) / np.linalg.norm(extents))
        T_world_object = np.eye(4)
        T_world_object[:3, :3], T_world_object[:3, 3] = box.R_world_object, box.centre_world
        model = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(size * shape))
        result = o3d.pipelines.registration.registration_icp(
            tree, model, _REACH_M, np.linalg.inv(T_world_object),
            o3d.pipelines.registration.TransformationEstimationPointToPoint(),
            o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=50),
        )  # fmt: skip
        T_world_object = np.linalg.inv(result.transformation)
        p_object = o3d.geometry.PointCloud(
            o3d.utility.Vector3dVector(transformed_back(T_world_object, points))
        )
        off = np.minimum(np.asarray(p_object.compute_point_cloud_distance(model)), _CUT_M).mean()
        pose = gtsam.Pose3(gtsam.Rot3.ClosestTo(T_world_object[:3, :3]), T_world_object[:3, 3])
        found.append(
            (float(off), ObjectState(pose, np.full(3, np.log(size)), np.array(prior.code_mean, float)))
        )
    return min(found, key=lambda each: each[0])[1]


@lru_cache(maxsize=8)
def _mean_shape(decoder: SdfDecoder, code: tuple[float, ...]) -> Float[np.ndarray, "n 3"]:
    """Points of its surface, canonical."""
    mesh = extract_mesh(decoder, np.array(code), resolution=64)
    return np.asarray(trimesh.sample.sample_surface(mesh, _POINTS, seed=0)[0])
