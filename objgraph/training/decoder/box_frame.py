"""A decoder's frame in which every shape of a category has one and the same bounding box."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objgraph.training.size import LEAST_SIGMA


@dataclass(frozen=True)
class BoxFrame:
    """Canonical coordinates stretched axis by axis to the category's typical box.

    An object's three scales are then its extents over the typical ones, whatever its code. The distance stays that of the unstretched shape with a box diagonal of 1, so that times the
    metric diagonal it is metres, and to first order 1 / ||h|| of `factors.sdf.metres_per_unit` whatever the scales.
    """

    extents: Float[np.ndarray, "3"]
    """Edges of the typical box, whose diagonal is 1."""
    anisotropy_sigma: float
    """Standard deviation of the logarithm of a shape's stretch about its mean over the axes."""

    @staticmethod
    def of(extents: Float[np.ndarray, "s 3"]) -> "BoxFrame":
        """The frame of shapes whose boxes have these edges: their geometric mean."""
        logs = np.log(extents)
        typical = np.exp(logs.mean(0))
        typical = typical / np.linalg.norm(typical)
        deviation = logs - np.log(typical)
        deviation -= deviation.mean(1, keepdims=True)
        # two of the three directions are free once the mean is taken out
        return BoxFrame(typical, max(LEAST_SIGMA, float(np.sqrt((deviation**2).sum(1).mean() / 2))))

    def stretch(self, extents: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """What canonical coordinates of a shape with these edges are divided by to be the decoder's."""
        return np.asarray(extents) / self.extents
