"""Priors on an object's own variables: ordinary GTSAM factors."""

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.checks import DEVIATIONS
from factors.state import LOG_SCALES, ObjectKeys

_ILL_CONDITIONED = 1e6
"""Ratio of a covariance's variances from which on GTSAM's own root of its inverse is not to be had."""


def code_prior(
    keys: ObjectKeys, mean: Float[np.ndarray, "l"], covariance: Float[np.ndarray, "l l"]
) -> gtsam.NonlinearFactor:
    """The code is distributed as the training codes were.

    Raises:
        FactorError: the mean is no vector of numbers, or the covariance none of its.
    """
    mean = checks.reals("the mean code", mean, (None,))
    covariance = checks.covariance("the codes' covariance", covariance, len(mean))
    return gtsam.PriorFactorVector(_keys(keys).code, mean, _gaussian(covariance))


def scale_covariance(size_sigma: float, anisotropy_sigma: float) -> Float[np.ndarray, "3 3"]:
    """Covariance of a log-scale whose common part and whose axes' deviations from it are independent."""
    common = np.full((3, 3), 1.0 / 3.0)
    return 3.0 * size_sigma**2 * common + anisotropy_sigma**2 * (np.eye(3) - common)


def scale_prior(
    keys: ObjectKeys, mean_log_scale: float, size_sigma: float, anisotropy_sigma: float
) -> gtsam.NonlinearFactor:
    """The object is as large as its category's are, and its three scales are nearly equal.

    `size_sigma` is the standard deviation of the mean log-scale, `anisotropy_sigma` that along both directions across it.
    As of all priors here, FactorError says which number is none, or a standard deviation that is not positive.
    """
    covariance = scale_covariance(
        _sigma("size_sigma", size_sigma), _sigma("anisotropy_sigma", anisotropy_sigma)
    )
    covariance = checks.covariance(
        "the log-scales' covariance, of size_sigma and anisotropy_sigma,", covariance, 3
    )
    mean = checks.number("mean_log_scale", mean_log_scale, LOG_SCALES)
    return gtsam.PriorFactorVector(_keys(keys).log_scale, np.full(3, mean), _gaussian(covariance))


def upright_prior(keys: ObjectKeys, up_world: Float[np.ndarray, "3"], sigma: float) -> gtsam.NonlinearFactor:
    """The object's own up axis (+y) points against gravity, to within `sigma` radians about each axis.

    The residual is up in the object's frame less that axis, 2 sin(lean / 2) long, which rises up to an object on its head.
    That is what GTSAM's magnetometer makes of a field. Its attitude factor has the sine, by axes of the world: one that
    leans then seems to tell its heading.
    """
    noise = gtsam.noiseModel.Isotropic.Sigma(3, _sigma("upright sigma", sigma))
    up_world = checks.direction("up_world", up_world)
    up_object, no_bias = np.array([0.0, 1.0, 0.0]), np.zeros(3)
    return gtsam.MagPoseFactorPose3(_keys(keys).pose, up_object, 1.0, up_world, no_bias, noise)


def placed_prior(
    keys: ObjectKeys,
    T_world_object: gtsam.Pose3,
    heading_sigma: float,
    lean_sigma: float,
    position_sigma: float,
) -> gtsam.NonlinearFactor:
    """The object is where a detector has it: radians about its own up axis and about the two others, metres."""
    lean, heading = _sigma("lean_sigma", lean_sigma), _sigma("heading_sigma", heading_sigma)
    position = _sigma("position_sigma", position_sigma)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([lean, heading, lean, *[position] * 3]))
    return gtsam.PriorFactorPose3(_keys(keys).pose, checks.pose("T_world_object", T_world_object), noise)


def sized_prior(keys: ObjectKeys, log_scale: Float[np.ndarray, "3"], sigma: float) -> gtsam.NonlinearFactor:
    """Each axis of the object is as long as a detector has it, to within `sigma` of its logarithm."""
    mean = checks.reals("log_scale", log_scale, (3,), LOG_SCALES)
    return gtsam.PriorFactorVector(
        _keys(keys).log_scale, mean, gtsam.noiseModel.Isotropic.Sigma(3, _sigma("size sigma", sigma))
    )


def _gaussian(covariance: Float[np.ndarray, "n n"]) -> gtsam.noiseModel.Gaussian:
    """Noise of a positive definite covariance, however unequal its variances are."""
    if np.linalg.cond(covariance) < _ILL_CONDITIONED:
        return gtsam.noiseModel.Gaussian.Covariance(covariance)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    return gtsam.noiseModel.Gaussian.SqrtInformation(np.linalg.qr(whitening, mode="r"))


def _keys(keys: ObjectKeys) -> ObjectKeys:
    return checks.instance("keys", keys, ObjectKeys)


def _sigma(what: str, value: float) -> float:
    return checks.number(what, value, DEVIATIONS)
