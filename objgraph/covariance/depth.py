"""The depth that a camera would measure of an object whose pose and shape are uncertain."""

from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.checks import LENGTHS, PLACES, SHARES
from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectState
from objgraph.covariance.heading_ring import by_heading
from objgraph.covariance.labelled import ObjectCovariance, of_one_object
from objgraph.covariance.ray_end import mixed_ends, ray_ends
from objgraph.errors import CovarianceError

_PLACES_AT_ONCE = 2**15
"""Of how many places the derivatives are held at a time."""


@dataclass(frozen=True)
class DepthDistribution:
    """Where each of r rays ends on the object, if it does; z-depths in the camera's frame, metres.

    A ray's errors are those of one pose and one code: with the object moved along it by some amount, it ends before a depth
    with the largest probability that any place so far on it is occupied.
    """

    depth: Float[np.ndarray, "r k"]
    """Rising; zero of rays that miss the object however it may stand."""
    reached: Float[np.ndarray, "r k"]
    """Probability that the ray has ended at or before each depth."""

    @property
    def hit(self) -> Float[np.ndarray, "r"]:
        """Probability that the ray ends on the object at all."""
        return self.reached[:, -1]

    def quantile(self, share: float) -> Float[np.ndarray, "r"]:
        """First depth by which that share of the rays that hit has ended; NaN where next to none does.

        Raises CovarianceError where `share` is not between 0 and 1.
        """
        at = checks.number("the share of a quantile", share, SHARES, CovarianceError) * self.hit
        right = (self.reached < at[:, None]).sum(axis=1)[:, None]
        left = np.maximum(right - 1, 0)
        p0, p1 = (np.take_along_axis(self.reached, i, axis=1)[:, 0] for i in (left, right))
        d0, d1 = (np.take_along_axis(self.depth, i, axis=1)[:, 0] for i in (left, right))
        part = np.divide(at - p0, p1 - p0, out=np.zeros_like(at), where=p1 > p0)
        return np.where(self.hit > 1e-3, d0 + part * (d1 - d0), np.nan)

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
        width = np.diff(self.depth, axis=1, prepend=self.depth[:, :1])
        middle = self.depth - 0.5 * width
        hit = np.where(self.hit > 1e-3, self.hit, np.nan)
        mean = (ends * middle).sum(axis=1) / hit
        square = (middle - mean[:, None]) ** 2 + width**2 / 12  # ends are spread evenly between two depths
        return np.stack([mean, np.sqrt((ends * square).sum(axis=1) / hit)])


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

    A heading that is known to no better than 15 degrees is integrated over (`by_heading`). The SDF is linear in all else but
    moves along the ray: of a ray through the object nearer to a flat side's outline than that may move, a hit is said to be surer
    than it is (1 cm within an outline known to 2 cm: 0.8 to 0.96, truly 0.69). What is thinner than 2 cm, as a bin's wall, is said
    to be missed at times, for the occupancy's slope is no steeper: 1 cm is hit with 0.84, 4 mm with 0.61.
    `residual_sigma` is the decoder's own error, canonical (`ShapePrior.residual_sigma`); the sensor's noise and other
    objects are not in it.

    Raises:
        CovarianceError: the covariance is not of this state, or the decoder, the camera or a direction is none.
    """
    checks.instance("decoder", decoder, SdfDecoder, CovarianceError)
    of_one_object(state, covariance)
    checks.pose("T_world_camera", T_world_camera, CovarianceError)
    directions_camera = checks.reals(
        "directions_camera", directions_camera, (None, 3), PLACES, CovarianceError
    )
    if not np.allclose(directions_camera[:, 2], 1.0):
        raise CovarianceError("directions_camera must have z = 1, so that lengths along them are z-depths")
    checks.number("residual_sigma", residual_sigma, LENGTHS, CovarianceError)
    checks.whole("samples", samples, checks.Range(2, 10_000), CovarianceError)
    depth, reached = np.zeros((2, len(directions_camera), samples))
    parts = by_heading(state, covariance)
    at_once = max(1, _PLACES_AT_ONCE // samples)
    for i in range(0, len(depth), at_once):
        some = slice(i, i + at_once)
        found = [
            ray_ends(decoder, turned, known, T_world_camera, directions_camera[some], residual_sigma, samples)
            for _, turned, known in parts
        ]
        depth[some], reached[some] = (
            found[0] if len(parts) == 1 else mixed_ends([share for share, _, _ in parts], found)
        )
    return DepthDistribution(depth, reached)
