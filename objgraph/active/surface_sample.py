"""A surface as cameras are asked about it: points spread evenly over its mesh."""

from dataclasses import dataclass

import gtsam
import numpy as np
import trimesh
import trimesh.sample
from jaxtyping import Float, Int

from factors.sdf import metres_per_unit, query_points, sdf_jacobian
from factors.state import ObjectState
from objgraph.mesh import extract_mesh
from objgraph.prior.prior import ShapePrior


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Points of a surface and the mesh that hides what is behind it."""

    points: Float[np.ndarray, "m 3"]
    """Evenly over the surface, world frame."""
    normals: Float[np.ndarray, "m 3"]
    """Outward, world frame."""
    residual: Float[np.ndarray, "m"]
    """The decoder's own standard deviation there, metres."""
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]


def sample_surface(
    prior: ShapePrior, state: ObjectState, points: int, resolution: int, seed: int
) -> SurfaceSample:
    """So many points of an object's surface.

    Raises:
        SolveError: the code has no surface.
    """
    mesh = extract_mesh(prior.decoder, state.code, resolution)
    vertices, faces = state.to_world(np.asarray(mesh.vertices)), np.asarray(mesh.faces)
    world = trimesh.Trimesh(vertices, faces, process=False)
    p_world, face = trimesh.sample.sample_surface(world, points, seed=seed)[:2]
    query = query_points(prior.decoder, state, gtsam.Pose3(), np.asarray(p_world))
    jet = prior.decoder.linearize(query.p_object, query.code[None])
    residual = (prior.residual_sigma * metres_per_unit(jet.d_point, state)).cpu().numpy()
    return SurfaceSample(np.asarray(p_world), np.asarray(world.face_normals)[face], residual, vertices, faces)


def metric_sdf(
    prior: ShapePrior, state: ObjectState, p_world: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m d"]]:
    """Signed distances to an object, metres, and their derivative w.r.t. pose, log-scale and code."""
    query = query_points(prior.decoder, state, gtsam.Pose3(), p_world)
    jet = prior.decoder.linearize(query.p_object, query.code[None])
    metres = metres_per_unit(jet.d_point, state).double()
    value = metres * jet.value.double().reshape(-1)
    jacobian = metres[:, None] * sdf_jacobian(query, jet, camera=False).double()
    return value.detach().cpu().numpy(), jacobian.detach().cpu().numpy()
