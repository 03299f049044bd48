"""The one place that says how a shape's canonical coordinates become those that a decoder takes."""

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.meshes.solid import require_depth


def to_decoder(prior: ShapePrior, extents: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Factors an axis by which canonical points are divided before decoding, and decoded meshes multiplied.

    `extents` are those of the shape's box, whose diagonal is 1. Distances are the same before and after: a
    decoder of boxes gives those of the unstretched shape.

    Raises:
        MeshError: the shape is flat, and the prior's fill a box.
    """
    if prior.box is None:
        return np.ones(3)
    require_depth(np.asarray(extents), "the shape")
    return np.asarray(extents) / prior.box


def multiplied(mesh: trimesh.Trimesh, factors: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    """A mesh with its coordinates multiplied axis by axis; `factors` are positive."""
    return trimesh.Trimesh(np.asarray(mesh.vertices) * factors, mesh.faces, process=False)
