"""Depth renderers: from the SDF along rays to residual rows against the observed depths."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from factors.occupancy import (
    PROBIT_SCALE,
    depth_mean_gradient,
    depth_moments,
    probit_occupancy,
    quadrature_moments,
)
from factors.rays import RayCells
from factors.score import energy_score, majorizing_weight

ESCAPE = 1.1
"""A ray that escapes is given this multiple of the depth at which it leaves the object's box."""


@dataclass(frozen=True)
class RayTargets:
    """Observations of r rays as tensors; the meaning of the fields is that of `factors.rays.Rays`."""

    depth: Float[Tensor, "r"]
    hit: Bool[Tensor, "r"]
    end: Float[Tensor, "r"]
    sigma: Float[Tensor, "r"]

    @property
    def stop(self) -> Float[Tensor, "r"]:
        """Depth of a hit; infinite where the ray passes the object."""
        return torch.where(self.hit, self.depth, torch.inf)


class RenderedRows(NamedTuple):
    """Scores of r rays in metres, and q residual rows each with their derivative w.r.t. the k samples' SDF."""

    loss: Float[Tensor, "r"]
    residual: Float[Tensor, "r q"]
    d_sdf: Float[Tensor, "r q k"]


class Renderer(Protocol):
    """Scores rays from the metric SDF at their cells; `spread` is what `freeze` returned."""

    def freeze(
        self, sdf: Tensor, sdf_sigma: Tensor, cells: RayCells, targets: RayTargets, slope: float
    ) -> Float[Tensor, "r"]:
        """Standard deviation of each ray's depth, metres, to be held while a quadratic is minimised."""
        ...

    def render(
        self,
        sdf: Float[Tensor, "r k"],
        sdf_sigma: Float[Tensor, "r k"],
        cells: RayCells,
        targets: RayTargets,
        slope: float,
        spread: Float[Tensor, "r"],
    ) -> RenderedRows: ...


@dataclass(frozen=True)
class FullDistribution:
    """The energy score of the whole termination distribution: the integral of (F(d) - 1[d >= d_obs])^2.

    F = 1 - T with T the expected transmittance, so the score is a sum of squares over a ray's cells, and the
    rows are natural Gauss-Newton rows. A free ray says T = 1 as far as it is known to be free.

    With `reach` the integral is weighted over depth (a threshold-weighted score, Gneiting & Ranjan 2011, proper
    for any weight that does not depend on the estimate): at an outline the score would otherwise be the length of
    the way behind the object, which is arbitrary and differs between the outline's two sides.
    """

    correlation: Literal["comonotone", "independent"] = "comonotone"
    """How occupancies along a ray depend on each other: "independent" multiplies (the paper's assumption; what
    is behind the first surface then depends on how densely it is sampled), "comonotone" takes the smallest
    1 - o so far (a ray's SDF errors are those of one pose and one code; independent of the sampling)."""
    reach: float | None = 3.0
    """Spreads about the surface's depth (for a free ray: of the outline next to it) that weigh fully; the rest of
    the ray on either side weighs as much as one more. None: every metre weighs the same."""

    def freeze(
        self, sdf: Tensor, sdf_sigma: Tensor, cells: RayCells, targets: RayTargets, slope: float
    ) -> Float[Tensor, "r"]:
        tau = _tau(sdf_sigma, targets, slope)
        return tau.gather(1, sdf.abs().argmin(dim=1, keepdim=True))[:, 0]

    def transmittance(
        self, sdf: Float[Tensor, "r k"], tau: Float[Tensor, "r k"]
    ) -> tuple[Float[Tensor, "r k"], Float[Tensor, "r k k"]]:
        """Expected transmittance behind every sample, and its derivative w.r.t. every sample's SDF."""
        clear = 1 - probit_occupancy(sdf, tau)
        slope = torch.exp(-0.5 * (sdf / tau) ** 2) / (math.sqrt(2 * math.pi) * tau)
        k = sdf.shape[1]
        if self.correlation == "comonotone":
            passed, first = torch.cummin(clear, dim=1)
            d_passed = torch.nn.functional.one_hot(first, k).to(sdf) * slope.gather(1, first)[..., None]
            return passed, d_passed
        passed = torch.cumprod(clear, dim=1)
        hazard = slope / clear.clamp_min(1e-300)
        lower = torch.tril(torch.ones(k, k, dtype=sdf.dtype))
        return passed, passed[:, :, None] * hazard[:, None, :] * lower

    def render(
        self,
        sdf: Float[Tensor, "r k"],
        sdf_sigma: Float[Tensor, "r k"],
        cells: RayCells,
        targets: RayTargets,
        slope: float,
        spread: Float[Tensor, "r"],
    ) -> RenderedRows:
        passed, d_passed = self.transmittance(sdf, _tau(sdf_sigma, targets, slope))
        width, escape = self._weighted_widths(cells, targets, spread)
        target = (cells.depth < targets.stop[:, None]).to(sdf)
        beyond = (cells.far < targets.stop).to(sdf)
        root, escape_root = (2 * width).sqrt(), (2 * escape).sqrt()
        residual = torch.cat(
            [root * (passed - target), (escape_root * (passed[:, -1] - beyond))[:, None]], dim=1
        )
        d_sdf = torch.cat([root[..., None] * d_passed, escape_root[:, None, None] * d_passed[:, -1:]], dim=1)
        return RenderedRows(0.5 * residual.square().sum(dim=1), residual, d_sdf)

    def _weighted_widths(
        self, cells: RayCells, targets: RayTargets, spread: Float[Tensor, "r"]
    ) -> tuple[Float[Tensor, "r k"], Float[Tensor, "r"]]:
        """Weighted length of every cell, and of the way from the box to where the ray escapes."""
        end = torch.minimum(targets.end, ESCAPE * cells.far)
        width = cells.width * (cells.depth < end[:, None])
        escape = (end - cells.far).clamp_min(0.0)
        if self.reach is None:
            return width, escape
        spread = spread[:, None]
        width = torch.cat([width, escape[:, None]], dim=1)
        depth = torch.cat([cells.depth, cells.far[:, None] + 0.5 * escape[:, None]], dim=1)
        offset = depth - targets.depth[:, None]
        near = offset.abs() < self.reach * spread
        weight = near.to(width)
        for side in (~near & (offset < 0), ~near & (offset > 0)):
            length = (width * side).sum(dim=1, keepdim=True).clamp_min(1e-12)
            weight = weight + side * (spread / length).clamp_max(1.0)
        width = width * weight
        return width[:, :-1], width[:, -1]


@dataclass(frozen=True)
class Probabilistic:
    """The paper's renderer: mean and variance of the depth, scored as a Gaussian (equ:2d_loss)."""

    variance: Literal["total", "epistemic"] = "total"
    """Which of the two variances scores: of the termination depth, or of its expectation."""

    def freeze(
        self, sdf: Tensor, sdf_sigma: Tensor, cells: RayCells, targets: RayTargets, slope: float
    ) -> Float[Tensor, "r"]:
        moments = depth_moments(quadrature_moments(sdf, sdf_sigma, slope), cells.depth, ESCAPE * cells.far)
        return (getattr(moments, self.variance) + targets.sigma**2).sqrt()

    def render(
        self,
        sdf: Float[Tensor, "r k"],
        sdf_sigma: Float[Tensor, "r k"],
        cells: RayCells,
        targets: RayTargets,
        slope: float,
        spread: Float[Tensor, "r"],
    ) -> RenderedRows:
        escape = ESCAPE * cells.far
        moments = quadrature_moments(sdf, sdf_sigma, slope)
        mean = depth_moments(moments, cells.depth, escape).mean
        # a free ray that ends inside the box has no depth to be compared with
        counts = (targets.hit | (targets.end >= cells.far)).to(sdf)
        error = mean - torch.where(targets.hit, targets.depth, escape)
        root = (counts * majorizing_weight(error, spread)).sqrt()
        d_mean = depth_mean_gradient(moments.mean, cells.depth, escape) * moments.d_mean(slope)
        return RenderedRows(
            counts * energy_score(error, spread),
            (root * error)[:, None],
            root[:, None, None] * d_mean[:, None, :],
        )


def _tau(sdf_sigma: Float[Tensor, "r k"], targets: RayTargets, slope: float) -> Float[Tensor, "r k"]:
    return (sdf_sigma**2 + targets.sigma[:, None] ** 2 + (PROBIT_SCALE / slope) ** 2).sqrt()
