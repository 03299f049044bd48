"""What an object's shape code says of its proportions, as a factor on both.

Where all shapes fill one box an object's proportions are in its scales, and shapes of a kind have those of the kind: a
screen on a wall is flat, one on a foot is not.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import LOG_SCALES, SCALE_DOF, ObjectKeys


@dataclass(frozen=True)
class Proportions:
    """A Gaussian of u = log(extents of a shape of diagonal 1 / the box that all shapes fill), linear in its code."""

    mean: Float[np.ndarray, "3"]
    """Of u at the code zero."""
    slope: Float[np.ndarray, "3 l"]
    """Derivative of the mean w.r.t. the code."""
    covariance: Float[np.ndarray, "3 3"]
    """Of u once the code is known."""

    def __post_init__(self) -> None:
        """Raises FactorError where one of them is none."""
        found = {
            "mean": checks.reals("the proportions' mean", self.mean, (SCALE_DOF,)),
            "slope": checks.reals("the proportions' slope", self.slope, (SCALE_DOF, None)),
            "covariance": checks.covariance("the proportions' covariance", self.covariance, SCALE_DOF),
        }
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def of(self, code: Float[np.ndarray, "*n l"]) -> Float[np.ndarray, "*n 3"]:
        """The mean of u of shapes with these codes."""
        return self.mean + np.asarray(code) @ self.slope.T


def proportions_prior(
    keys: ObjectKeys, proportions: Proportions, mean_log_size: float, size_sigma: float
) -> gtsam.NonlinearFactor:
    """The object is as large as its category's are, and its proportions are those of its shape.

    log-scale = log-diagonal (1, 1, 1) + u, where the logarithm of the box's diagonal, metres, is of mean `mean_log_size`
    and deviation `size_sigma`. Linear in both variables, so it is the same wherever it is linearised.

    Raises:
        FactorError: one of the numbers is none, or the deviation is not positive.
    """
    keys = checks.instance("keys", keys, ObjectKeys)
    checks.instance("proportions", proportions, Proportions)
    mean = checks.number("mean_log_size", mean_log_size, LOG_SCALES)
    sigma = checks.number("size_sigma", size_sigma, checks.DEVIATIONS)
    covariance = sigma**2 * np.ones((SCALE_DOF, SCALE_DOF)) + proportions.covariance
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    linear = gtsam.JacobianFactor(
        keys.log_scale, whitening, keys.code, -whitening @ proportions.slope,
        whitening @ (mean + proportions.mean), gtsam.noiseModel.Unit.Create(SCALE_DOF),
    )  # fmt: skip
    zero = gtsam.Values()
    zero.insert(keys.log_scale, np.zeros(SCALE_DOF))
    zero.insert(keys.code, np.zeros(proportions.slope.shape[1]))
    return gtsam.LinearContainerFactor(linear, zero)
