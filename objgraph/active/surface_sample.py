"""A surface as cameras are asked about it: points spread evenly over its mesh."""

from dataclasses import dataclass

import numpy as np
import trimesh
import trimesh.sample
from jaxtyping import Float, Int

from factors.state import ObjectState
from objgraph.covariance.surface import metric_sdf_jacobian
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior


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
    metres = metric_sdf_jacobian(prior.decoder, state, np.asarray(p_world))[2]
    residual = prior.residual_sigma * metres.numpy()
    return SurfaceSample(np.asarray(p_world), np.asarray(world.face_normals)[face], residual, vertices, faces)
