"""Whether an estimate's covariance tells where its surface is wrong: the protocol of the paper's fig_uncertainty."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import pearsonr, spearmanr

from factors.state import ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.surface import metric_sdf
from objgraph.datasets.ground_truth import GroundTruth
from objgraph.metrics.placed import PlacedMesh
from objgraph.metrics.shape import seen_points_on
from objgraph.priors.shape_prior import ShapePrior

POINTS = 10_000
"""Points on what is seen of the true surface, uniform by area."""
BINS = 100
"""Of the standard deviation."""
_CONSTANT = 1e-9  # spread of the standard deviations, relative to their mean, that is none


@dataclass(frozen=True)
class SurfaceErrors:
    """At points of the true surface, metres."""

    error: Float[np.ndarray, "n"]
    """|SDF| of the estimate, which is zero where it is right."""
    sigma: Float[np.ndarray, "n"]
    """Standard deviation of the SDF by the estimate's joint covariance of pose, scale and code."""
    metres: Float[np.ndarray, "n"] | float = 1.0
    """Metres a unit of the decoder's SDF at each point: the paper correlates the decoder's own values."""

    @property
    def pearson(self) -> float | None:
        """Correlation of the two in the decoder's units; None where either is constant or not finite.

        Gaussian errors of known standard deviations that differ widely reach 0.80 at most.
        """
        return float(pearsonr(*self._canonical).statistic) if self._varies else None

    @property
    def pearson_binned(self) -> float | None:
        """Correlation of sigma and the mean error in 100 bins of equally many points by rising sigma; None as for `pearson`.

        Averages over 100 points leave little of the errors' own chance, so that it is higher than `pearson`. The paper's
        released evaluation computes both, and the paper does not say which of them its table has.
        """
        if not self._varies:
            return None
        error, sigma = self._canonical
        parts = np.array_split(np.argsort(sigma, kind="stable"), BINS)
        means = np.array([[sigma[part].mean(), error[part].mean()] for part in parts if len(part)])
        return float(pearsonr(*means.T).statistic) if len(means) > 2 else None

    @property
    def spearman(self) -> float | None:
        """Correlation of their ranks; None as for `pearson`."""
        return float(spearmanr(*self._canonical).statistic) if self._varies else None

    @property
    def _canonical(self) -> Float[np.ndarray, "2 n"]:
        return np.stack([self.error, self.sigma]) / self.metres

    @property
    def _varies(self) -> bool:
        both = self._canonical
        return bool(np.isfinite(both).all() and (np.ptp(both, axis=1) > _CONSTANT * both.mean(axis=1)).all())

    def some(self, count: int, seed: int = 0) -> "SurfaceErrors":
        """A random part of the points."""
        chosen = np.random.default_rng(seed).permutation(len(self.error))[:count]
        metres = np.broadcast_to(self.metres, self.error.shape)
        return SurfaceErrors(self.error[chosen], self.sigma[chosen], metres[chosen])


def gaussian_pearson(sigma: Float[np.ndarray, "n"]) -> float | None:
    """Correlation with `sigma` that |error| would have if errors were Gaussian with these standard deviations.

    sqrt(2/pi) sd(s) / sqrt(E[s^2] - 2/pi E[s]^2): the less the standard deviations differ, the less is to be had,
    and never more than 0.80. None where they do not differ.
    """
    mean, spread = sigma.mean(), sigma.std()
    if not np.isfinite(mean) or spread <= _CONSTANT * mean:
        return None
    return float(np.sqrt(2 / np.pi) * spread / np.sqrt((sigma**2).mean() - 2 / np.pi * mean**2))


def surface_errors(
    prior: ShapePrior,
    state: ObjectState,
    covariance: ObjectCovariance,
    truth: GroundTruth,
    points: int = POINTS,
    seed: int = 0,
) -> SurfaceErrors:
    """|SDF| of the estimate at points of the true surface, and sqrt(diag(J Σ J^T)) there (eq:sdf_variance), with the
    prior's `surface_misfit` as a factor on Σ.

    Raises:
        EvaluationError: the ground truth is no mesh, or its pose no pose.
    """
    p_world = seen_points_on(PlacedMesh.of_truth(truth), points, seed)
    of_surface = covariance.times(prior.surface_misfit)
    sdf, sigma, metres = metric_sdf(prior.decoder, state, of_surface, p_world)
    return SurfaceErrors(sdf.abs().numpy(), sigma.numpy(), metres.numpy())
