"""The energy score of the whole distribution of a ray's end."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from factors.occupancy import PROBIT_SCALE, probit_occupancy
from factors.rays import RayCells
from factors.rendering import ESCAPE, RaySamples, RayTargets, RenderedRows


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

    def freeze(self, samples: RaySamples) -> Float[Tensor, "r"]:
        return _tau(samples).gather(1, samples.sdf.abs().argmin(dim=1, keepdim=True))[:, 0]

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

    def render(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> RenderedRows:
        passed, d_passed = self.transmittance(samples.sdf, _tau(samples))
        root, escape_root, residual = self._residual(passed, samples.cells, samples.targets, spread)
        d_sdf = torch.cat([root[..., None] * d_passed, escape_root[:, None, None] * d_passed[:, -1:]], dim=1)
        return RenderedRows(0.5 * residual.square().sum(dim=1), residual, d_sdf)

    def score(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """See `Renderer`; the weights over depth are held."""
        spread = self.freeze(samples).detach()
        clear = 1 - probit_occupancy(samples.sdf, _tau(samples))
        passed = clear.cummin(dim=1)[0] if self.correlation == "comonotone" else clear.cumprod(dim=1)
        return 0.5 * self._residual(passed, samples.cells, samples.targets, spread)[2].square().sum(dim=1)

    def _residual(
        self,
        passed: Float[Tensor, "r k"],
        cells: RayCells,
        targets: RayTargets,
        spread: Float[Tensor, "r"],
    ) -> tuple[Float[Tensor, "r k"], Float[Tensor, "r"], Float[Tensor, "r k+1"]]:
        """Roots of the weights of the cells and of the way beyond the box, and the weighted residual of all."""
        width, escape = self._weighted_widths(cells, targets, spread)
        target = (cells.depth < targets.stop[:, None]).to(passed)
        beyond = (cells.far < targets.stop).to(passed)
        root, escape_root = (2 * width).sqrt(), (2 * escape).sqrt()
        inside, outside = root * (passed - target), escape_root * (passed[:, -1] - beyond)
        return root, escape_root, torch.cat([inside, outside[:, None]], dim=1)

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


def _tau(samples: RaySamples) -> Float[Tensor, "r k"]:
    sensor = samples.targets.sigma[:, None]
    return (samples.sdf_sigma**2 + sensor**2 + (PROBIT_SCALE / samples.slope) ** 2).sqrt()
