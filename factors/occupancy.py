"""From an uncertain SDF to occupancy, termination and depth along rays (paper section on rendering).

Occupancy is a sloped, mirrored sigmoid of a Gaussian SDF (eq:sloped_sigmoid), hence logit-normal
(eq:logit_normal_pdf). Occupancies of a ray's samples are independent, so moments of their products are
products of their moments.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

PROBIT_SCALE = 1.702
"""sigmoid(x) is within 0.01 of Phi(x / 1.702)."""


class OccupancyMoments(NamedTuple):
    """First and second raw moments of logit-normal occupancies."""

    mean: Float[Tensor, "..."]
    second: Float[Tensor, "..."]

    def d_mean(self, slope: float) -> Float[Tensor, "..."]:
        """Derivative of the mean w.r.t. the SDF's mean: E[-l o (1 - o)]."""
        return -slope * (self.mean - self.second)


def occupancy_quantile(
    u: Float[Tensor, "..."], mu: Float[Tensor, "..."], sigma: Float[Tensor, "..."], slope: float
) -> Float[Tensor, "..."]:
    """Quantile function of the logit-normal occupancy (paper eq:logit_normal_quantile)."""
    return torch.sigmoid(slope * math.sqrt(2) * sigma * torch.erfinv(2 * u - 1) - slope * mu)


def sobol_moments(
    mu: Float[Tensor, "..."], sigma: Float[Tensor, "..."], slope: float, samples: int = 128
) -> OccupancyMoments:
    """The paper's moments: quasi-Monte Carlo with the inverse transform on Sobol points."""
    o = occupancy_quantile(_sobol(samples, mu), mu[..., None], sigma[..., None], slope)
    return OccupancyMoments(o.mean(dim=-1), o.square().mean(dim=-1))


def quadrature_moments(
    mu: Float[Tensor, "..."], sigma: Float[Tensor, "..."], slope: float, nodes: int = 64
) -> OccupancyMoments:
    """The same moments by the trapezoidal rule over six standard deviations, smooth in its arguments.

    For an analytic integrand the rule converges exponentially, and it resolves a steep sigmoid with fewer nodes
    than Gauss-Hermite's, which crowd in the tails.
    """
    x = torch.linspace(-6, 6, nodes, dtype=mu.dtype, device=mu.device)
    weight = torch.softmax(-0.5 * x.square(), dim=0)
    o = torch.sigmoid(-slope * (mu[..., None] + sigma[..., None] * x))
    return OccupancyMoments(o @ weight, o.square() @ weight)


def probit_occupancy(mu: Float[Tensor, "..."], tau: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Mean occupancy in closed form, Phi(-mu / tau), with tau^2 = sigma^2 + (1.702 / l)^2."""
    return torch.special.ndtr(-mu / tau)


def termination(
    occupancy: Float[Tensor, "r k"],
) -> tuple[Float[Tensor, "r k"], Float[Tensor, "r"]]:
    """Expected termination probability of every sample, and of escape (eq:terminamte_escape); sum is one."""
    passed = torch.cumprod(1 - occupancy, dim=1)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    return occupancy * before, passed[:, -1]


def depth_mean(
    occupancy: Float[Tensor, "r k"], depth: Float[Tensor, "r k"], escape: Float[Tensor, "r"]
) -> Float[Tensor, "r"]:
    """Expected depth at which a ray ends, its escape counted at depth `escape`."""
    probability, escaped = termination(occupancy)
    return (probability * depth).sum(dim=1) + escaped * escape


def total_depth_variance(
    occupancy: Float[Tensor, "r k"], depth: Float[Tensor, "r k"], escape: Float[Tensor, "r"]
) -> Float[Tensor, "r"]:
    """Variance of the depth at which a ray ends, about its mean."""
    probability, escaped = termination(occupancy)
    mean = (probability * depth).sum(dim=1) + escaped * escape
    return (probability * (depth - mean[:, None]) ** 2).sum(dim=1) + escaped * (escape - mean) ** 2


def uncentred_depth_variance(
    mu: Float[Tensor, "r k"],
    sigma: Float[Tensor, "r k"],
    slope: float,
    depth: Float[Tensor, "r k"],
    escape: Float[Tensor, "r"],
    draws: int = 128,
) -> Float[Tensor, "r"]:
    """Sum of d_k^2 Var(m_k), m_k being the termination probabilities, and the escape's at depth `escape` the last.

    All samples share one Sobol sequence, so their occupancies rise and fall together, draw by draw. Depths count from
    the camera and covariances are left out: the sum is no variance of the depth, and grows as the object goes away.
    """
    x = math.sqrt(2) * torch.erfinv(2 * _sobol(draws, mu) - 1)
    logit = slope * (sigma[..., None] * x - mu[..., None])
    # in logarithms, whose derivatives are cheap: log (1 - o) = log sigmoid(-logit)
    passed = torch.nn.functional.logsigmoid(-logit).cumsum(dim=1).exp()
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    ends = torch.cat([before - passed, passed[:, -1:]], dim=1).var(dim=2, unbiased=False)
    return (torch.cat([depth, escape[:, None]], dim=1).square() * ends).sum(dim=1)


def depth_mean_gradient(
    occupancy: Float[Tensor, "r k"], depth: Float[Tensor, "r k"], escape: Float[Tensor, "r"]
) -> Float[Tensor, "r k"]:
    """Derivative of the mean depth w.r.t. each sample's mean occupancy: T_{i-1} (d_i - E[D_{i+1}])."""
    passed = torch.cumprod(1 - occupancy, dim=1)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    gradient = torch.empty_like(depth)
    beyond = escape
    for i in range(depth.shape[1] - 1, -1, -1):
        gradient[:, i] = before[:, i] * (depth[:, i] - beyond)
        beyond = occupancy[:, i] * depth[:, i] + (1 - occupancy[:, i]) * beyond
    return gradient


def _sobol(count: int, like: Tensor) -> Float[Tensor, "count"]:
    engine = torch.quasirandom.SobolEngine(1, scramble=True, seed=0)
    return engine.draw(count, dtype=torch.float64).to(like)[:, 0].clamp(1e-7, 1 - 1e-7)
