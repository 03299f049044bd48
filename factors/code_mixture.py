"""A mixture of Gaussians over shape codes, and the prior factor of one object's code."""

from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from factors import checks
from factors.errors import FactorError
from factors.keys import readable_key
from factors.reduce import guarded_factor
from factors.state import ObjectKeys


@dataclass(frozen=True)
class CodeMixture:
    """k Gaussians over codes of length l, each with independent axes."""

    weight: Float[np.ndarray, "k"]
    """How likely a code is of each; they sum to one."""
    mean: Float[np.ndarray, "k l"]
    variance: Float[np.ndarray, "k l"]

    def __post_init__(self) -> None:
        """Raises FactorError where the arrays do not fit each other or are not finite and positive."""
        for name, shape in (("weight", (None,)), ("mean", (None, None)), ("variance", (None, None))):
            found = checks.array(f"a mixture's {name}", getattr(self, name), shape, finite=False)
            object.__setattr__(self, name, found)
        k, shape = len(self.weight), self.mean.shape
        if (
            self.weight.shape != (k,)
            or len(shape) != 2
            or len(self.mean) != k
            or self.variance.shape != shape
        ):
            raise FactorError(
                f"a mixture of {self.weight.shape} weights does not fit means of {shape} and variances of "
                f"{self.variance.shape}"
            )
        positive = (self.weight > 0).all() and (self.variance > 0).all()
        finite = all(np.isfinite(a).all() for a in (self.weight, self.mean, self.variance))
        if not k or not positive or not finite or abs(self.weight.sum() - 1) > 1e-6:
            raise FactorError(
                "a mixture needs positive weights that sum to one, finite means, positive variances"
            )

    @cached_property
    def rarity(self) -> Float[np.ndarray, "k"]:
        """Cost, nats, of the middle of each Gaussian, the least of them 0."""
        cost = 0.5 * np.log(self.variance).sum(axis=1) - np.log(self.weight)
        return cost - cost.min()

    def costs(self, codes: Float[np.ndarray, "b l"]) -> Float[np.ndarray, "b k"]:
        """Negative logarithm of each Gaussian's weighted density at each code, up to one constant."""
        information = 1 / self.variance
        spread = codes**2 @ information.T - 2 * codes @ (self.mean * information).T
        return 0.5 * (spread + (self.mean**2 * information).sum(axis=1)) + self.rarity

    def likeliest(self, codes: Float[np.ndarray, "b l"]) -> Int[np.ndarray, "b"]:
        """Which Gaussian has most of the density at each code."""
        return self.costs(codes).argmin(axis=1)

    def moments(self) -> tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l l"]]:
        """Mean and covariance of all codes."""
        mean = self.weight @ self.mean
        offset = self.mean - mean
        return mean, np.diag(self.weight @ self.variance) + (self.weight[:, None] * offset).T @ offset

    def draw(self, count: int, rng: Generator, within: float | None = None) -> Float[np.ndarray, "n l"]:
        """Random codes, none beyond `within` standard deviations of its Gaussian along an axis if that is given."""
        which = rng.choice(len(self.weight), size=count, p=self.weight)
        whitened = rng.normal(size=(count, self.mean.shape[1]))
        while within is not None and (beyond := np.abs(whitened) > within).any():
            whitened[beyond] = rng.normal(size=np.count_nonzero(beyond))
        return self.mean[which] + np.sqrt(self.variance[which]) * whitened


def mixture_prior(keys: ObjectKeys, codes: CodeMixture) -> gtsam.CustomFactor:
    """The code is of one of the mixture's Gaussians, the likeliest at each evaluation.

    Its last row has no derivative: what the Gaussian's rarity costs. (Olson & Agarwal, "Inference on networks of
    mixtures for robust robot mapping", 2013.)

    Raises:
        FactorError: `keys` or `codes` are none; on evaluation, if the code has another length than the mixture's.
    """
    checks.instance("keys", keys, ObjectKeys)
    checks.instance("codes", codes, CodeMixture)
    length = codes.mean.shape[1]

    def evaluate(values: gtsam.Values, jacobian: bool):
        code = values.atVector(keys.code)
        if len(code) != length:
            raise FactorError(
                f"{readable_key(keys.code)} holds a code of length {len(code)}, its prior is of {length}"
            )
        i = codes.likeliest(code[None])[0]
        root = 1 / np.sqrt(codes.variance[i])
        residual = np.append(root * (code - codes.mean[i]), np.sqrt(2 * codes.rarity[i]))
        return residual, [np.vstack([np.diag(root), np.zeros(length)])] if jacobian else None

    return guarded_factor([keys.code], [length], length + 1, evaluate, "mixture_prior")
