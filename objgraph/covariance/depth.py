"""The depth that a camera would measure of an object whose pose and shape are uncertain."""

from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Float

from factors import checks
from factors.checks import LENGTHS, PLACES
from factors.occupancy import PROBIT_SCALE, probit_occupancy
from factors.rays import box_interval, coarse_depths
from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance, of_one_object
from objgraph.covariance.surface import metric_sdf
from objgraph.errors import CovarianceError
from objgraph.geometry.frames import transformed

_SLOPE = 400.0
"""Of the occupancy's sigmoid, 1/metres (paper eq:sloped_sigmoid)."""


@dataclass(frozen=True)
class DepthDistribution:
    """Where each of r rays ends on the object, if it does; z-depths in the camera's frame, metres.

    A ray's errors are those of one pose and one code: it ends before a depth with the largest probability that any
    place so far on it is occupied.
    """

    depth: Float[np.ndarray, "r k"]
    """Rising; of rays that miss the object's box, zero."""
    reached: Float[np.ndarray, "r k"]
    """Probability that the ray has ended at or before each depth."""

    @property
    def hit(self) -> Float[np.ndarray, "r"]:
        """Probability that the ray ends on the object at all."""
        return self.reached[:, -1]

    def quantile(self, share: float) -> Float[np.ndarray, "r"]:
        """Depth before which that share of the rays that hit has ended; NaN where next to none does."""
        at = share * self.hit
        return np.array(
            [
                np.interp(a, p, d) if h > 1e-3 else np.nan
                for a, p, d, h in zip(at, self.reached, self.depth, self.hit, strict=True)
            ]
        )

    @property
    def mean(self) -> Float[np.ndarray, "r"]:
        """Expected depth of a hit; NaN where next to none is."""
        return self._moments[0]

    @property
    def sigma(self) -> Float[np.ndarray, "r"]:
        """Standard deviation of a hit's depth about its mean; NaN where next to none is."""
        return self._moments[1]

    @property
    def _moments(self) -> Float[np.ndarray, "2 r"]:
        ends = np.diff(self.reached, axis=1, prepend=0.0)
        middle = self.depth - 0.5 * np.diff(self.depth, axis=1, prepend=self.depth[:, :1])
        hit = np.where(self.hit > 1e-3, self.hit, np.nan)
        mean = (ends * middle).sum(axis=1) / hit
        return np.stack([mean, np.sqrt((ends * (middle - mean[:, None]) ** 2).sum(axis=1) / hit)])


def predicted_depth(
    decoder: SdfDecoder,
    state: ObjectState,
    covariance: ObjectCovariance,
    T_world_camera: gtsam.Pose3,
    directions_camera: Float[np.ndarray, "r 3"],
    *,
    residual_sigma: float = 0.0,
    samples: int = 64,
) -> DepthDistribution:
    """Distribution of the depth along rays with directions of z = 1, from the uncertain SDF along each.

    `residual_sigma` is the decoder's own error, canonical (`ShapePrior.residual_sigma`); the sensor's noise and other
    objects are not in it.

    Raises:
        CovarianceError: the covariance is not of this state, or the camera or a direction is none.
    """
    of_one_object(state, covariance)
    checks.pose("T_world_camera", T_world_camera, CovarianceError)
    directions_camera = checks.reals(
        "directions_camera", directions_camera, (None, 3), PLACES, CovarianceError
    )
    if not np.allclose(directions_camera[:, 2], 1.0):
        raise CovarianceError("directions_camera must have z = 1, so that lengths along them are z-depths")
    checks.number("residual_sigma", residual_sigma, LENGTHS, CovarianceError)
    checks.whole("samples", samples, checks.Range(2, 10_000), CovarianceError)
    near, far = box_interval(state, T_world_camera, directions_camera)
    meets = np.flatnonzero(far - near > 1e-3)
    depth, reached = np.zeros((len(near), samples)), np.zeros((len(near), samples))
    if len(meets):
        depth[meets] = coarse_depths(
            torch.as_tensor(near[meets]), torch.as_tensor(far[meets]), samples
        ).numpy()
        p_camera = directions_camera[meets][:, None, :] * depth[meets][:, :, None]
        p_world = transformed(T_world_camera.matrix(), p_camera.reshape(-1, 3))
        sdf, sigma, metres = metric_sdf(decoder, state, covariance, p_world)
        tau = (sigma**2 + (residual_sigma * metres) ** 2 + (PROBIT_SCALE / _SLOPE) ** 2).sqrt()
        occupied = probit_occupancy(sdf, tau).view(len(meets), samples)
        reached[meets] = occupied.cummax(dim=1)[0].numpy()
    return DepthDistribution(depth, reached)
