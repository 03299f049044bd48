"""An object as a map knows it, ready to be asked what a view of it would tell."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import trimesh
import trimesh.sample
from jaxtyping import Float, Int

from factors.sdf import metres_per_unit, query_points, sdf_jacobian
from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import ActiveVisionError
from objgraph.mesh import extract_mesh
from objgraph.prior.prior import ShapePrior


@dataclass(frozen=True, eq=False)
class KnownObject:
    """An estimate, and its surface linearised once: candidates differ only in which of its points they see."""

    name: str
    information: Float[np.ndarray, "d d"]
    """Inverse covariance of pose, log-scale and code."""
    points: Float[np.ndarray, "m 3"]
    """Evenly over the surface, world frame."""
    normals: Float[np.ndarray, "m 3"]
    """Outward, world frame."""
    jacobian: Float[np.ndarray, "m d"]
    """Of the metric SDF at the points."""
    residual: Float[np.ndarray, "m"]
    """The decoder's own standard deviation there, metres."""
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    seen_from: tuple[gtsam.Pose3, ...] = ()
    """T_world_camera of the views that the estimate is made from; none says that nothing of it was seen yet."""

    @property
    def surface_sigma(self) -> Float[np.ndarray, "m"]:
        """Standard deviation of the surface along its normal at the points, metres."""
        covariance = np.linalg.inv(self.information)
        return np.sqrt(np.einsum("mi,ij,mj->m", self.jacobian, covariance, self.jacobian, optimize=True))

    @property
    def centre(self) -> Float[np.ndarray, "3"]:
        """Of its box along the world's axes."""
        return (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2


def known_object(
    name: str,
    prior: ShapePrior,
    state: ObjectState,
    covariance: ObjectCovariance,
    *,
    seen_from: Sequence[gtsam.Pose3] = (),
    points: int = 600,
    resolution: int = 48,
    seed: int = 0,
) -> KnownObject:
    """What an estimate that was made from some views says of its surface, at that many points.

    Raises:
        ActiveVisionError: the covariance is not of this state, or not positive definite.
        SolveError: the code has no surface.
    """
    d = 9 + len(state.code)
    if covariance.matrix.shape != (d, d):
        raise ActiveVisionError(
            f"{name}: its covariance is over {len(covariance.axes)} axes, its state has {d}"
        )
    try:
        root = np.linalg.inv(np.linalg.cholesky(covariance.matrix))
    except np.linalg.LinAlgError as error:
        raise ActiveVisionError(f"{name}: its covariance is not positive definite") from error
    mesh = extract_mesh(prior.decoder, state.code, resolution)
    vertices, faces = state.to_world(np.asarray(mesh.vertices)), np.asarray(mesh.faces)
    world = trimesh.Trimesh(vertices, faces, process=False)
    p_world, face = trimesh.sample.sample_surface(world, points, seed=seed)[:2]
    query = query_points(prior.decoder, state, gtsam.Pose3(), np.asarray(p_world))
    jet = prior.decoder.linearize(query.p_object, query.code[None])
    metres = metres_per_unit(jet.d_point, state).double()
    jacobian = metres[:, None] * sdf_jacobian(query, jet, camera=False).double()
    residual = (prior.residual_sigma * metres).cpu().numpy()
    normals = np.asarray(world.face_normals)[face]
    return KnownObject(
        name,
        root.T @ root,
        np.asarray(p_world),
        normals,
        jacobian.detach().cpu().numpy(),
        residual,
        vertices,
        faces,
        tuple(seen_from),
    )
