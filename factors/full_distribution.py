"""The energy score of the whole distribution of a ray's end."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.occupancy import PROBIT_SCALE, probit_occupancy
from factors.rendering import ESCAPE, RaySamples, RenderedRows


@dataclass(frozen=True)
class FullDistribution:
    """The energy score of the whole termination distribution: the integral of (F(d) - 1[d >= d_obs])^2.

    F = 1 - T with T the expected transmittance, so the score is a sum of squares over a ray's cells, and the
    rows are natural Gauss-Newton rows. A free ray says T = 1 as far as it is known to be free.

    T is the smallest 1 - o so far: a ray's SDF errors are those of one pose and one code, and rise and fall together. (The paper
    multiplies, as if they were independent: what is behind the first surface then depends on how densely it is sampled.)

    With `reach` the integral is weighted over depth (a threshold-weighted score, Gneiting & Ranjan 2011, proper
    for any weight that does not depend on the estimate): at an outline the score would otherwise be the length of
    the way behind the object, which is arbitrary and differs between the outline's two sides.
    """

    reach: float | None = 3.0
    """Spreads about the surface's depth (for a free ray: of the outline next to it) that weigh fully; the rest of
    the ray on either side weighs as much as one more. None: every metre weighs the same."""

    def __post_init__(self) -> None:
        """Raises FactorError where the reach is not positive."""
        checks.settings(self, reach=checks.POSITIVE)

    def freeze(self, samples: RaySamples) -> Float[Tensor, "r"]:
        return _tau(samples).gather(1, samples.sdf.abs().argmin(dim=1, keepdim=True))[:, 0]

    def transmittance(
        self, sdf: Float[Tensor, "r k"], tau: Float[Tensor, "r k"]
    ) -> tuple[Float[Tensor, "r k"], Float[Tensor, "r k k"]]:
        """Expected transmittance behind every sample, and its derivative w.r.t. every sample's SDF."""
        clear = 1 - probit_occupancy(sdf, tau)
        slope = torch.exp(-0.5 * (sdf / tau) ** 2) / (math.sqrt(2 * math.pi) * tau)
        passed, first = torch.cummin(clear, dim=1)
        d_passed = torch.nn.functional.one_hot(first, sdf.shape[1]).to(sdf)
        return passed, d_passed * slope.gather(1, first)[..., None]

    def render(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> RenderedRows:
        passed, d_passed = self.transmittance(samples.sdf, _tau(samples))
        weights = self._weights(samples, spread)
        residual = _residual(passed, weights, samples)
        d_behind = weights.behind.mul(2).sqrt()[..., None] * d_passed[:, -1:]
        d_sdf = torch.cat([weights.cells.mul(2).sqrt()[..., None] * d_passed, d_behind], dim=1)
        return RenderedRows(weights.before + 0.5 * residual.square().sum(dim=1), residual, d_sdf)

    def score(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """See `Renderer`; the weights over depth are held."""
        return self.loss(samples, self.freeze(samples).detach())

    def loss(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> Float[Tensor, "r"]:
        """See `Renderer`."""
        clear = 1 - probit_occupancy(samples.sdf, _tau(samples))
        passed = clear.cummin(dim=1)[0]
        weights = self._weights(samples, spread)
        return weights.before + 0.5 * _residual(passed, weights, samples).square().sum(dim=1)

    def _weights(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> "_Weights":
        cells, hit, depth = samples.cells, samples.targets.hit, samples.targets.depth
        end = torch.minimum(samples.targets.end, ESCAPE * torch.maximum(cells.far, depth))
        start = cells.depth - 0.5 * cells.width
        # the ray outside of the box: from a hit's depth to the box, from the box to the depth, from both to the end
        before = torch.where(hit, torch.minimum(start[:, 0], end), depth)
        low = torch.column_stack([start, depth, cells.far, torch.maximum(cells.far, depth)])
        high = torch.column_stack([start + cells.width, before, torch.minimum(depth, end), end])
        length = (torch.minimum(high, end[:, None]) - low).clamp_min(0.0)
        if self.reach is not None:
            reach, at = self.reach * spread[:, None], depth[:, None]
            high = low + length
            front = (torch.minimum(high, at - reach) - low).clamp_min(0.0)
            back = (high - torch.maximum(low, at + reach)).clamp_min(0.0)
            # a cell may be longer than the reach: what counts in full is its part within
            length = length - front - back
            for rest in (front, back):
                length = length + rest * (spread / rest.sum(dim=1).clamp_min(1e-12)).clamp_max(1.0)[:, None]
        return _Weights(length[:, :-3], length[:, -3], length[:, -2:])


class _Weights(NamedTuple):
    """Weighted lengths of the parts of a ray, metres."""

    cells: Float[Tensor, "r k"]
    before: Float[Tensor, "r"]
    """From a hit's depth on to the box, where nothing can have stopped the ray."""
    behind: Float[Tensor, "r 2"]
    """From the box on to the surface's depth, and from there on to where the ray escapes."""


def _residual(passed: Float[Tensor, "r k"], weights: _Weights, samples: RaySamples) -> Float[Tensor, "r k+2"]:
    targets = samples.targets
    target = (samples.cells.depth < targets.stop[:, None]).to(passed)
    behind = torch.stack([torch.ones_like(targets.depth), (~targets.hit).to(passed)], dim=1)
    inside = weights.cells.mul(2).sqrt() * (passed - target)
    return torch.cat([inside, weights.behind.mul(2).sqrt() * (passed[:, -1:] - behind)], dim=1)


def _tau(samples: RaySamples) -> Float[Tensor, "r k"]:
    sensor = samples.targets.sigma[:, None]
    return (samples.sdf_sigma**2 + sensor**2 + (PROBIT_SCALE / samples.slope) ** 2).sqrt()
