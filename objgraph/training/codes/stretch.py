"""The one place that says how a shape's canonical coordinates become those that a decoder takes."""

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.priors.shape_prior import ShapePrior


def to_decoder(prior: ShapePrior, extents: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Factors an axis by which canonical points are divided before decoding, and decoded meshes multiplied.

    `extents` are those of the shape's box, whose diagonal is 1. Distances are the same before and after: a
    decoder of boxes gives those of the unstretched shape.
    """
    return np.ones(3) if prior.box is None else np.asarray(extents) / prior.box


def multiplied(mesh: trimesh.Trimesh, factors: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    """A mesh with its coordinates multiplied axis by axis; `factors` are positive."""
    return trimesh.Trimesh(np.asarray(mesh.vertices) * factors, mesh.faces, process=False)
