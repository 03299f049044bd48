"""Codes that explain signed distances and lower bounds on them: Levenberg-Marquardt from many starts at once."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from factors import checks
from factors.sdf_decoder import SdfDecoder
from objgraph.errors import ConfigError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.meshes.samples import SdfSamples

_CHUNK = 16384
"""Points linearised together."""


@dataclass(frozen=True)
class CodeRows:
    """What a code must explain, in the decoder's coordinates."""

    points: Float[np.ndarray, "n 3"]
    target: Float[np.ndarray, "n"]
    """Signed distance there, or a lower bound of it."""
    deviation: Float[np.ndarray, "n"]
    """Standard deviation of the decoder's value; Huber's loss turns linear there."""
    weight: Float[np.ndarray, "n"]
    """How many independent measurements a row counts for, against the code's prior."""
    one_sided: Bool[np.ndarray, "n"]
    """Where the target is a lower bound: only values below it count."""

    def __len__(self) -> int:
        return len(self.points)

    def thinned(self, count: int, rng: np.random.Generator) -> "CodeRows":
        """At most `count` rows, which together count for as much as all did."""
        if count >= len(self):
            return self
        row = rng.choice(len(self), count, replace=False)
        share = self.weight.sum() / self.weight[row].sum()
        return CodeRows(
            self.points[row],
            self.target[row],
            self.deviation[row],
            self.weight[row] * share,
            self.one_sided[row],
        )

    def joined(self, other: "CodeRows") -> "CodeRows":
        """These rows and others."""
        pairs = zip(self._arrays(), other._arrays(), strict=True)
        return CodeRows(*(np.concatenate(pair) for pair in pairs))

    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.points, self.target, self.deviation, self.weight, self.one_sided


class Quadratic(NamedTuple):
    """A cost, half its gradient and half its (majorising) Hessian at b codes."""

    cost: Float[np.ndarray, "b"]
    gradient: Float[np.ndarray, "b l"]
    hessian: Float[np.ndarray, "b l l"]


class CodeGaussians(NamedTuple):
    """The Gaussians over codes, of which each code is held to the likeliest."""

    mean: Float[np.ndarray, "k l"]
    information: Float[np.ndarray, "k l l"]
    rarity: Float[np.ndarray, "k"]
    """Cost of each one's mean."""

    @classmethod
    def of(cls, prior: ShapePrior) -> "CodeGaussians":
        """A prior's own, with a ridge that keeps a covariance of few shapes regular."""
        if prior.kinds is not None:
            information = np.einsum("kl,lm->klm", 1 / prior.kinds.variance, np.eye(prior.kinds.mean.shape[1]))
            return cls(prior.kinds.mean, information, 2 * prior.kinds.rarity)
        covariance = np.asarray(prior.code_covariance, float)
        length = len(covariance)
        ridge = 1e-8 * np.trace(covariance) / length
        information = np.linalg.inv(covariance + ridge * np.eye(length))
        return cls(np.asarray(prior.code_mean, float)[None], information[None], np.zeros(1))

    def at(self, codes: Float[np.ndarray, "b l"]) -> Quadratic:
        """How codes are pulled toward likelier ones."""
        offset = codes[:, None] - self.mean
        pull = np.einsum("bkl,klm->bkm", offset, self.information)
        cost = (pull * offset).sum(axis=2) + self.rarity
        row, best = np.arange(len(codes)), cost.argmin(axis=1)
        return Quadratic(cost[row, best], pull[row, best], self.information[best])


class Found(NamedTuple):
    """Codes and their costs (twice the negative log-posterior, up to a constant), cheapest first."""

    codes: Float[np.ndarray, "b l"]
    costs: Float[np.ndarray, "b"]


@dataclass(frozen=True)
class SearchConfig:
    """How a code is searched for from many starts."""

    first_points: int = 500
    """Rows that every start is tried on."""
    first_iterations: int = 6
    """Iterations of every start."""
    kept: int = 2
    """Starts that go on with all rows."""
    iterations: int = 30
    """Most iterations of those."""
    tolerance: float = 1e-4
    """Relative fall of the cost below which a start is done."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some = checks.Range(1)
        checks.settings(
            self, ConfigError, first_points=some, first_iterations=some, kept=some, iterations=some
        )


def search(prior: ShapePrior, rows: CodeRows, config: SearchConfig | None = None, seed: int = 0) -> Found:
    """The most probable codes given the rows: from the prior's mean and prototypes, on few rows, then the best on all."""
    config = config or SearchConfig()
    held = CodeGaussians.of(prior)
    few = rows.thinned(config.first_points, np.random.default_rng(seed))
    first = descend(prior.decoder, few, held, prior.starts, config.first_iterations, config.tolerance)
    return descend(prior.decoder, rows, held, first.codes[: config.kept], config.iterations, config.tolerance)


def descend(
    decoder: SdfDecoder,
    rows: CodeRows,
    held: CodeGaussians,
    starts: Float[np.ndarray, "b l"],
    iterations: int,
    tolerance: float = 1e-4,
) -> Found:
    """Levenberg-Marquardt on reweighted errors from every start; all starts go through the decoder together."""
    codes = np.array(starts, float)
    at = _linearized(decoder, rows, held, codes)
    damping = np.full(len(codes), 1e-3)
    going = np.ones(len(codes), bool)
    for _ in range(iterations):
        active = np.flatnonzero(going)
        if len(active) == 0:
            break
        trial = codes[active] - _steps(at, damping, active)
        new = _linearized(decoder, rows, held, trial)
        better = new.cost < at.cost[active]
        falls = at.cost[active] - new.cost
        done = better & (falls < tolerance * at.cost[active])
        chosen = active[better]
        codes[chosen] = trial[better]
        for old, fresh in zip(at, new, strict=True):
            old[chosen] = fresh[better]
        damping[active] = np.where(better, np.maximum(damping[active] / 5, 1e-6), damping[active] * 5)
        going[active] = ~done & (damping[active] < 1e6)
    order = np.argsort(at.cost, kind="stable")
    return Found(codes[order], at.cost[order])


def sample_rows(
    samples: SdfSamples,
    stretch: Float[np.ndarray, "3"] | None = None,
    sigma: float = 0.01,
    effective: float = 10_000.0,
) -> CodeRows:
    """Rows of signed-distance samples; `stretch` is that of `objgraph.training.codes.stretch.to_decoder`, without it 1.

    `sigma` is the error's scale on the surface; it grows away from it as the training loss's weight falls.
    `effective` counts the samples as that many independent ones against the prior: distances known everywhere
    need it little, and the shapes of synthetic chairs come out better the less it says.
    """
    count = len(samples.sdf)
    return CodeRows(
        samples.points if stretch is None else samples.points / stretch,
        samples.sdf,
        sigma * (1 + np.abs(samples.sdf) / 0.05),
        np.full(count, effective / count),
        np.zeros(count, bool),
    )


def _steps(
    at: Quadratic, damping: Float[np.ndarray, "b"], active: Int[np.ndarray, "a"]
) -> Float[np.ndarray, "a l"]:
    hessian = at.hessian[active].copy()
    diagonal = np.arange(hessian.shape[1])
    hessian[:, diagonal, diagonal] *= 1 + damping[active, None]
    return np.linalg.solve(hessian, at.gradient[active][..., None])[..., 0]


def _linearized(
    decoder: SdfDecoder, rows: CodeRows, held: CodeGaussians, codes: Float[np.ndarray, "b l"]
) -> Quadratic:
    value, jacobian = _values(decoder, rows.points, codes)
    error = (value - rows.target) / rows.deviation
    error = np.where(rows.one_sided, np.minimum(error, 0.0), error)
    size = np.abs(error)
    weight = rows.weight * np.where(size > 1, 1 / np.maximum(size, 1), 1.0)
    # a bound that holds says nothing
    weight = np.where(rows.one_sided & (error == 0), 0.0, weight)
    rho = np.where(size > 1, 2 * size - 1, size**2)
    pull = held.at(codes)
    scaled = jacobian / rows.deviation[:, None]
    gradient = np.einsum("bnl,bn->bl", scaled, weight * error) + pull.gradient
    hessian = scaled.transpose(0, 2, 1) @ (weight[..., None] * scaled) + pull.hessian
    cost = rho @ rows.weight + pull.cost
    return Quadratic(cost, gradient, hessian)


def _values(
    decoder: SdfDecoder, points: Float[np.ndarray, "n 3"], codes: Float[np.ndarray, "b l"]
) -> tuple[Float[np.ndarray, "b n"], Float[np.ndarray, "b n l"]]:
    """The decoder's values at all points under every code, and their derivatives w.r.t. it."""
    like = decoder.like
    b, n = len(codes), len(points)
    z = torch.as_tensor(codes, dtype=like.dtype, device=like.device)
    p = torch.as_tensor(np.ascontiguousarray(points), dtype=like.dtype, device=like.device).repeat(b, 1)
    owner = torch.arange(b, device=like.device).repeat_interleave(n)
    jets = [
        decoder.linearize(part, z, own)
        for part, own in zip(p.split(_CHUNK), owner.split(_CHUNK), strict=True)
    ]
    value = torch.cat([jet.value for jet in jets]).double().cpu().numpy().reshape(b, n)
    d_code = torch.cat([jet.d_code for jet in jets]).double().cpu().numpy().reshape(b, n, -1)
    return value, d_code
