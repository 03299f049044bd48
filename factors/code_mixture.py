"""The prior on a code that comes from a mixture of Gaussians, all equally likely and of one covariance."""

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from factors.errors import FactorError
from factors.reduce import guarded_factor
from factors.state import ObjectKeys


def code_mixture(
    keys: ObjectKeys, means: Float[np.ndarray, "k l"], covariance: Float[np.ndarray, "l l"]
) -> gtsam.NonlinearFactor:
    """Half the squared Mahalanobis distance to the nearest mean: the mixture's likeliest component.

    Olson & Agarwal, "Inference on networks of mixtures for robust robot mapping", IJRR 2013: the mixture's sum becomes
    its largest term, which a least-squares solver can hold. Halfway between means the gradient jumps, the loss does not.

    Raises:
        FactorError: means and covariance are of codes of different lengths, or the covariance is not positive definite.
    """
    means, covariance = np.asarray(means, float), np.asarray(covariance, float)
    length = means.shape[-1]
    if means.ndim != 2 or len(means) == 0 or covariance.shape != (length, length):
        raise FactorError(f"means {means.shape} and a covariance {covariance.shape} are of no one mixture")
    try:
        root = solve_triangular(np.linalg.cholesky(covariance), np.eye(length), lower=True)
    except np.linalg.LinAlgError as error:
        raise FactorError("the covariance of a mixture of codes is not positive definite") from error
    whitened = means @ root.T

    def evaluate(values: gtsam.Values, jacobian: bool) -> tuple[np.ndarray, list[np.ndarray] | None]:
        offsets = root @ values.atVector(keys.code) - whitened
        nearest = np.einsum("kl,kl->k", offsets, offsets).argmin()
        return offsets[nearest].copy(), [root] if jacobian else None

    return guarded_factor([keys.code], [length], length, evaluate, "CodeMixture")
