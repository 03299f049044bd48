"""Priors on an object's own variables: ordinary GTSAM factors."""

import gtsam
import numpy as np
from jaxtyping import Float

from factors.state import ObjectKeys


def code_prior(
    keys: ObjectKeys, mean: Float[np.ndarray, "l"], covariance: Float[np.ndarray, "l l"]
) -> gtsam.NonlinearFactor:
    """The code is distributed as the training codes were."""
    return gtsam.PriorFactorVector(
        keys.code,
        np.asarray(mean, float),
        gtsam.noiseModel.Gaussian.Covariance(np.asarray(covariance, float)),
    )


def scale_covariance(size_sigma: float, anisotropy_sigma: float) -> Float[np.ndarray, "3 3"]:
    """Covariance of a log-scale whose common part and whose axes' deviations from it are independent."""
    common = np.full((3, 3), 1.0 / 3.0)
    return 3.0 * size_sigma**2 * common + anisotropy_sigma**2 * (np.eye(3) - common)


def scale_prior(
    keys: ObjectKeys, mean_log_scale: float, size_sigma: float, anisotropy_sigma: float
) -> gtsam.NonlinearFactor:
    """The object is as large as its category's are, and its three scales are nearly equal.

    `size_sigma` is the standard deviation of the mean log-scale, `anisotropy_sigma` of each axis about it.
    """
    covariance = scale_covariance(size_sigma, anisotropy_sigma)
    return gtsam.PriorFactorVector(
        keys.log_scale, np.full(3, float(mean_log_scale)), gtsam.noiseModel.Gaussian.Covariance(covariance)
    )


def upright_prior(keys: ObjectKeys, up_world: Float[np.ndarray, "3"], sigma: float) -> gtsam.NonlinearFactor:
    """The object's own up axis (+y) points against gravity, to within `sigma` radians about each axis."""
    noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    return gtsam.AttitudeFactorPose3(
        keys.pose, gtsam.Unit3(np.asarray(up_world, float)), noise, gtsam.Unit3(np.array([0.0, 1.0, 0.0]))
    )


def placed_prior(
    keys: ObjectKeys,
    T_world_object: gtsam.Pose3,
    heading_sigma: float,
    lean_sigma: float,
    position_sigma: float,
) -> gtsam.NonlinearFactor:
    """The object is where a detector has it: radians about its own up axis and about the two others, metres."""
    rotation = [lean_sigma, heading_sigma, lean_sigma]
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([*rotation, *[position_sigma] * 3]))
    return gtsam.PriorFactorPose3(keys.pose, T_world_object, noise)


def sized_prior(keys: ObjectKeys, log_scale: Float[np.ndarray, "3"], sigma: float) -> gtsam.NonlinearFactor:
    """Each axis of the object is as long as a detector has it, to within `sigma` of its logarithm."""
    return gtsam.PriorFactorVector(
        keys.log_scale, np.asarray(log_scale, float), gtsam.noiseModel.Isotropic.Sigma(3, sigma)
    )
