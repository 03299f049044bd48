"""The prior on a code where most shapes are of known kinds and some are not: a mixture of Gaussians."""

from typing import NamedTuple

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from factors.errors import FactorError
from factors.reduce import guarded_factor
from factors.state import ObjectKeys


class CodeKinds(NamedTuple):
    """Gaussians of one covariance, all equally likely, about codes of known shapes."""

    means: Float[np.ndarray, "k l"]
    covariance: Float[np.ndarray, "l l"]


OTHERS = 0.01
"""Probability of a shape of no known kind."""


def code_mixture(
    keys: ObjectKeys, kinds: CodeKinds, mean: Float[np.ndarray, "l"], covariance: Float[np.ndarray, "l l"]
) -> gtsam.NonlinearFactor:
    """Negative log-density of the likeliest component: one of the kinds or, as one in a hundred shapes is, N(mean, covariance).

    Olson & Agarwal, "Inference on networks of mixtures for robust robot mapping", IJRR 2013: the mixture's sum becomes
    its largest term, which a least-squares solver can hold. Where another component becomes the likeliest the gradient
    jumps, the loss does not; it is zero at the peak of the highest.

    Raises:
        FactorError: the Gaussians are of codes of different lengths, or a covariance is not positive definite.
    """
    means = np.asarray(kinds.means, float)
    length = means.shape[-1]
    if means.ndim != 2 or len(means) == 0 or np.shape(mean) != (length,):
        raise FactorError(f"kinds about {means.shape} and a mean {np.shape(mean)} are of no one mixture")
    kind_root, kind_constant = _whitened(kinds.covariance, length, (1 - OTHERS) / len(means))
    root, constant = _whitened(covariance, length, OTHERS)
    centres, centre = means @ kind_root.T, root @ mean
    least = min(kind_constant, constant)

    def evaluate(values: gtsam.Values, jacobian: bool) -> tuple[np.ndarray, list[np.ndarray] | None]:
        code = values.atVector(keys.code)
        offsets = kind_root @ code - centres
        squares = np.einsum("kl,kl->k", offsets, offsets)
        nearest = squares.argmin()
        other = root @ code - centre
        is_kind = 0.5 * squares[nearest] + kind_constant <= 0.5 * other @ other + constant
        offset, used = (offsets[nearest], kind_root) if is_kind else (other, root)
        slack = np.sqrt(2 * ((kind_constant if is_kind else constant) - least))
        return np.append(offset, slack), [np.vstack([used, np.zeros(length)])] if jacobian else None

    return guarded_factor([keys.code], [length], length + 1, evaluate, "CodeMixture")


def _whitened(
    covariance: Float[np.ndarray, "l l"], length: int, weight: float
) -> tuple[Float[np.ndarray, "l l"], float]:
    """L^-1 for a covariance L L^T, and what its Gaussian adds to half a squared distance, but for what all add."""
    covariance = np.asarray(covariance, float)
    if covariance.shape != (length, length):
        raise FactorError(f"a covariance {covariance.shape} is not of codes of length {length}")
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as error:
        raise FactorError("a covariance of a mixture of codes is not positive definite") from error
    root = solve_triangular(lower, np.eye(length), lower=True)
    return root, float(np.log(np.diag(lower)).sum() - np.log(weight))
