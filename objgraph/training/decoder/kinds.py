"""The kinds of shapes that codes are of: a mixture of Gaussians, fitted to the codes while these are held to it.

Shapes differ in what is there at all, legs or a column, and no Gaussian is dense at both and nowhere between. (Tomczak &
Welling, "VAE with a VampPrior", 2018, for priors that are what the codes are.)
"""

import numpy as np
import torch
from jaxtyping import Float
from scipy.cluster.vq import kmeans2
from torch import Tensor

from factors.code_mixture import CodeMixture

_SHARED = 2.0
"""Shapes that the usual spread within a kind counts for in the spread of each: some have few of their own."""
_OTHER = 0.02
"""Share of codes that are of no kind, with the mean and spread of all: what is held out may be (a defensive mixture, Hesterberg,
"Weighted average importance sampling and defensive mixture distributions", 1995)."""


class Kinds:
    """N(0, I) at first, then the mixture that the last `fit` found."""

    def __init__(self, count: int, like: Float[Tensor, "s l"], seed: int = 0) -> None:
        """So many kinds, and a last Gaussian of what is of none, of codes as long and where `like` is; one is N(0, I) for good."""
        self.count, self.seed = count, seed
        self.weight = like.new_ones(1)
        self.mean, self.variance = like.new_zeros(1, like.shape[1]), like.new_ones(1, like.shape[1])

    def divergence(
        self, mean: Float[Tensor, "b l"], log_variance: Float[Tensor, "b l"]
    ) -> Float[Tensor, "b"]:
        """Bound, nats, of the Kullback-Leibler divergence of Gaussians from the mixture; of one Gaussian the divergence.

        (Hershey & Olsen, "Approximating the Kullback Leibler divergence between Gaussian mixture models", 2007.)
        """
        return -torch.logsumexp(self.weight.log() - self._divergences(mean, log_variance), dim=1)

    @torch.no_grad()
    def fit(self, mean: Float[Tensor, "s l"], log_variance: Float[Tensor, "s l"]) -> None:
        """One step of expectation and maximisation; the first time from clusters of the means."""
        if self.count == 1:
            return
        if len(self.weight) == 1:
            points = mean.cpu().double().numpy()
            nearest = kmeans2(points, self.count, minit="++", rng=np.random.default_rng(self.seed))[1]
            own = torch.nn.functional.one_hot(torch.from_numpy(nearest).long(), self.count + 1).to(mean)
        else:
            own = torch.softmax(self.weight.log() - self._divergences(mean, log_variance), dim=1)
        own, variance = own[:, :-1], log_variance.exp()
        shapes = own.sum(dim=0)[:, None]
        middle = (own.T @ mean) / (shapes + 1e-6)
        spread = (own.T @ (variance + mean.square()) - shapes * middle.square()).clamp_min(0)
        within = (spread + _SHARED * spread.sum(dim=0) / shapes.sum()) / (shapes + _SHARED)
        weight = (1 - _OTHER) * (shapes[:, 0] + 1) / (shapes.sum() + len(shapes))
        self.mean = torch.cat([middle, mean.mean(dim=0, keepdim=True)])
        self.variance = torch.cat([within, (variance.mean(dim=0) + mean.var(dim=0))[None]])
        self.weight = torch.cat([weight, weight.new_full((1,), _OTHER)])

    def mixture(self) -> CodeMixture | None:
        """As it is now; None where it is one Gaussian."""
        if len(self.weight) == 1:
            return None
        weight, mean, variance = (each.cpu().double().numpy() for each in self.state().values())
        return CodeMixture(weight / weight.sum(), mean, variance)

    def moments(
        self, mean: Float[Tensor, "s l"], log_variance: Float[Tensor, "s l"]
    ) -> tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l l"]]:
        """Mean and covariance of all codes: of the mixture; of one Gaussian, N(0, I), those that the codes themselves have."""
        if (mixture := self.mixture()) is not None:
            return mixture.moments()
        means, variance = mean.cpu().double().numpy(), log_variance.exp().mean(dim=0).cpu().double().numpy()
        return means.mean(axis=0), np.cov(means.T, bias=True) + np.diag(variance)

    def state(self) -> dict[str, Tensor]:
        """Everything as named tensors."""
        return {"weight": self.weight, "mean": self.mean, "variance": self.variance}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Put a state back.

        Raises:
            KeyError: something is missing.
        """
        self.weight, self.mean, self.variance = (
            state[name].to(self.mean) for name in ("weight", "mean", "variance")
        )

    def _divergences(
        self, mean: Float[Tensor, "b l"], log_variance: Float[Tensor, "b l"]
    ) -> Float[Tensor, "b k"]:
        """Kullback-Leibler divergence of each Gaussian from each of the mixture's."""
        information = 1 / self.variance
        spread = log_variance.exp() @ information.T + mean.square() @ information.T
        spread = spread - 2 * mean @ (self.mean * information).T + (self.mean.square() * information).sum(1)
        return 0.5 * (spread + self.variance.log().sum(1) - log_variance.sum(1, keepdim=True) - mean.shape[1])
