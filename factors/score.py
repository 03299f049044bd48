"""The energy score of a one-dimensional Gaussian, exactly, and as a least-squares row; and a score that lets go.

A proper scoring rule (Gneiting & Raftery, JASA 2007); paper equ:es estimates it from samples.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

_UNIT_CURVATURE = math.sqrt(math.pi / 2)


def energy_score(mu: Float[Tensor, "..."], sigma: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """E|s| - E|s - s'|/2 for s, s' ~ N(mu, sigma^2), in the unit of mu: the score of the target 0.

    sigma (x (2 Phi(x) - 1) + 2 phi(x) - 1/sqrt(pi)) with x = mu / sigma.
    """
    x = mu / sigma
    density = torch.exp(-0.5 * x.square()) / math.sqrt(2 * math.pi)
    return sigma * (x * torch.erf(x / math.sqrt(2)) + 2 * density - 1 / math.sqrt(math.pi))


def majorizing_weight(mu: Float[Tensor, "..."], sigma: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """w with w mu = dES/dmu: the quadratic w mu^2 / 2 + const touches ES at mu and lies above it elsewhere.

    ES is concave in mu^2, so its tangent in mu^2 majorises it (half-quadratic minimisation).
    """
    x = mu / sigma
    small = x.abs() < 1e-5  # there it is the limit to one in 1e11
    safe = torch.where(small, 1.0, x)
    return torch.where(small, math.sqrt(2 / math.pi), torch.erf(safe / math.sqrt(2)) / safe) / sigma


def unit_information_weight(sigma: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Weight that gives an energy score the curvature 1/sigma^2 at its minimum: sqrt(pi/2) / sigma."""
    return _UNIT_CURVATURE / sigma


def energy_score_monte_carlo(
    mu: Float[Tensor, "n"], sigma: Float[Tensor, "n"], samples: int = 1000, seed: int = 0
) -> Float[Tensor, "n"]:
    """The paper's estimate (equ:es): mean |s_m| minus half the mean |s_m - s_{m+1}| of i.i.d. samples."""
    generator = torch.Generator(device=mu.device).manual_seed(seed)
    noise = torch.randn(samples, *mu.shape, generator=generator, dtype=mu.dtype, device=mu.device)
    s = mu + sigma * noise
    return s.abs().mean(dim=0) - 0.5 * s.diff(dim=0).abs().mean(dim=0)


def cauchy_score(r: Float[Tensor, "..."], tail: float) -> Float[Tensor, "..."]:
    """Cauchy's loss of standardised residuals: half their square where they are small, let go beyond `tail`."""
    return 0.5 * tail**2 * torch.log1p((r / tail) ** 2)


def cauchy_root(r: Float[Tensor, "..."], tail: float) -> Float[Tensor, "..."]:
    """w with w^2 r = dscore/dr: (w r)^2 / 2 + const touches `cauchy_score` at r and lies above it elsewhere."""
    return (1.0 + (r / tail) ** 2).rsqrt()


def bounded_score(score: Float[Tensor, "..."], tail: float) -> Float[Tensor, "..."]:
    """A score s >= 0 itself where it is small, at most pi/2 times `tail`, in its unit: tail arctan(s / tail).

    Increasing and concave in s, so that what majorises s majorises this times `bounded_slope` (arctan loss, as SciPy's).
    """
    return tail * torch.arctan(score / tail)


def bounded_slope(score: Float[Tensor, "..."], tail: float) -> Float[Tensor, "..."]:
    """The derivative of `bounded_score` by the score."""
    return 1.0 / (1.0 + (score / tail).square())
