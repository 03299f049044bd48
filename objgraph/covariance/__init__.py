"""What is known how well: marginals, boxes, surfaces, predicted depth."""

from objgraph.covariance.box import BoxPose, box_pose
from objgraph.covariance.depth import predicted_depth
from objgraph.covariance.frames import in_world, of_xi
from objgraph.covariance.fused import fused
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.posterior import Posterior, marginals
from objgraph.covariance.surface import surface_sigma

__all__ = [
    "BoxPose",
    "ObjectCovariance",
    "Posterior",
    "box_pose",
    "fused",
    "in_world",
    "marginals",
    "of_xi",
    "predicted_depth",
    "surface_sigma",
]
