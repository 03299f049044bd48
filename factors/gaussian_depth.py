"""Renderers that describe a ray's end by one Gaussian depth, as the paper and the methods it compares with do."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.occupancy import (
    OccupancyMoments,
    depth_mean,
    depth_mean_gradient,
    quadrature_moments,
    sobol_moments,
    total_depth_variance,
    uncentred_depth_variance,
)
from factors.rendering import RaySamples, RenderedRows
from factors.score import energy_score, majorizing_weight

_LEAST_SPREAD = 1e-6
"""Metres; the energy score of a surer depth is its absolute error."""


class GaussianDepth(ABC):
    """Mean and variance of the rendered depth, scored as a Gaussian (paper equ:2d_loss).

    A free ray's depth is where it escapes. One that ends before it has left the object's box has no depth to be
    compared with and counts nothing.
    """

    @abstractmethod
    def occupancy(self, sdf: Tensor, sdf_sigma: Tensor, slope: float) -> OccupancyMoments:
        """Moments of the occupancy at every cell."""

    def ray_variance(self, samples: RaySamples, moments: OccupancyMoments) -> Float[Tensor, "r"]:
        """Variance of the rendered depth, square metres: of where the ray ends, over its samples."""
        return total_depth_variance(moments.mean, samples.cells.depth, samples.escape)

    def freeze(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """See `Renderer`; the sensor's own variance is added."""
        moments = self.occupancy(samples.sdf, samples.sdf_sigma, samples.slope)
        variance = self.ray_variance(samples, moments)
        return (variance + samples.targets.sigma**2).sqrt()

    def render(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> RenderedRows:
        """See `Renderer`."""
        error, counts, d_sdf = self.depth_error(samples)
        root = (counts * majorizing_weight(error, spread)).sqrt()
        return RenderedRows(
            counts * energy_score(error, spread), (root * error)[:, None], (root[:, None] * d_sdf)[:, None, :]
        )

    def loss(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> Float[Tensor, "r"]:
        """See `Renderer`."""
        moments = self.occupancy(samples.sdf, samples.sdf_sigma, samples.slope)
        mean = depth_mean(moments.mean, samples.cells.depth, samples.escape)
        error, counts = _error(mean, samples)
        return counts * energy_score(error, spread)

    def depth_error(
        self, samples: RaySamples
    ) -> tuple[Float[Tensor, "r"], Float[Tensor, "r"], Float[Tensor, "r k"]]:
        """Rendered minus observed depth, 1 where the ray counts, and the error's derivative w.r.t. the SDF."""
        depth, moments = samples.cells.depth, self.occupancy(samples.sdf, samples.sdf_sigma, samples.slope)
        error, counts = _error(depth_mean(moments.mean, depth, samples.escape), samples)
        d_sdf = depth_mean_gradient(moments.mean, depth, samples.escape) * moments.d_mean(samples.slope)
        return error, counts, d_sdf

    def score(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """See `Renderer`; as in the paper the sensor is taken to be exact."""
        depth, moments = samples.cells.depth, self.occupancy(samples.sdf, samples.sdf_sigma, samples.slope)
        error, counts = _error(depth_mean(moments.mean, depth, samples.escape), samples)
        variance = self.ray_variance(samples, moments)
        return counts * energy_score(error, variance.clamp_min(_LEAST_SPREAD**2).sqrt())


@dataclass(frozen=True)
class Probabilistic(GaussianDepth):
    """The paper's: an uncertain SDF makes uncertain occupancies, and these an uncertain depth."""

    moments: Literal["quadrature", "sobol"] = "quadrature"
    """How the logit-normal's moments are found: "sobol" is the paper's, 128 points by the inverse transform."""

    def __post_init__(self) -> None:
        """Raises FactorError where there is no such way to find them."""
        checks.settings(self, draws=checks.Range(2, 2**16))

    def occupancy(self, sdf: Tensor, sdf_sigma: Tensor, slope: float) -> OccupancyMoments:
        """Logit-normal moments; where the SDF is certain, those of a number."""
        of = quadrature_moments if self.moments == "quadrature" else sobol_moments
        uncertain = sdf_sigma > 0
        if uncertain.all():
            return of(sdf, sdf_sigma, slope)
        certain = _certain_occupancy(sdf, slope)
        some = of(sdf[uncertain], sdf_sigma[uncertain], slope)
        return OccupancyMoments(
            certain.mean.masked_scatter(uncertain, some.mean),
            certain.second.masked_scatter(uncertain, some.second),
        )


@dataclass(frozen=True)
class Uncentred(Probabilistic):
    """The released program's: `uncentred_depth_variance`, from draws that all samples share, about the paper's mean."""

    moments: Literal["quadrature", "sobol"] = "sobol"
    """Of the mean."""
    draws: int = 128

    def ray_variance(self, samples: RaySamples, moments: OccupancyMoments) -> Float[Tensor, "r"]:
        """None where a ray is certain all along."""
        some = (samples.sdf_sigma > 0).any(dim=1)
        variance = uncentred_depth_variance(
            samples.sdf[some], samples.sdf_sigma[some], samples.slope,
            samples.cells.depth[some], samples.escape[some], self.draws,
        )  # fmt: skip
        return torch.zeros_like(samples.escape).masked_scatter(some, variance)


@dataclass(frozen=True)
class Sampled(GaussianDepth):
    """NodeSLAM's (Sucar et al., 3DV 2020): the spread of where the ray may end, of an SDF taken to be certain."""

    def occupancy(self, sdf: Tensor, sdf_sigma: Tensor, slope: float) -> OccupancyMoments:
        """Of the SDF's mean alone."""
        return _certain_occupancy(sdf, slope)


@dataclass(frozen=True)
class Deterministic(GaussianDepth):
    """DSP-SLAM's (Wang et al., 3DV 2021): the expected depth alone."""

    squared_up_to: float | None = None
    """Square metres: the score that is followed is the squared error, no more than this (the released program); None
    follows the absolute error. `freeze` and `render` do not know it."""

    def __post_init__(self) -> None:
        """Raises FactorError where the bound is not positive."""
        checks.settings(self, squared_up_to=checks.POSITIVE)

    def score(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """See `Renderer`."""
        if self.squared_up_to is None:
            return super().score(samples)
        moments = self.occupancy(samples.sdf, samples.sdf_sigma, samples.slope)
        error, counts = _error(depth_mean(moments.mean, samples.cells.depth, samples.escape), samples)
        return counts * error.square().clamp_max(self.squared_up_to)

    def occupancy(self, sdf: Tensor, sdf_sigma: Tensor, slope: float) -> OccupancyMoments:
        """Of the SDF's mean alone."""
        return _certain_occupancy(sdf, slope)

    def ray_variance(self, samples: RaySamples, moments: OccupancyMoments) -> Float[Tensor, "r"]:
        """None: the score is then the absolute error."""
        return torch.zeros_like(samples.escape)


def _certain_occupancy(sdf: Tensor, slope: float) -> OccupancyMoments:
    occupancy = torch.sigmoid(-slope * sdf)
    return OccupancyMoments(occupancy, occupancy.square())


def _error(mean: Float[Tensor, "r"], samples: RaySamples) -> tuple[Float[Tensor, "r"], Float[Tensor, "r"]]:
    """Rendered minus observed depth, and 1 where there is an observed depth, else 0."""
    targets = samples.targets
    counts = (targets.hit | (targets.end >= samples.cells.far)).to(mean)
    return mean - torch.where(targets.hit, targets.depth, samples.escape), counts
