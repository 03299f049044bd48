"""How much a row of a score counts: as statistical information, or as the paper's fixed weight."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.errors import FactorError
from factors.score import unit_information_weight

LENGTHS = checks.Range(0.0, 1e6)
"""Metres or canonical units that mean something."""
DEVIATIONS = checks.Range(1e-9, 1e6)
"""Standard deviations, metres, that have an inverse."""
PLACES = checks.Range(-1e6, 1e6)
"""Coordinates, metres."""


@dataclass(frozen=True, eq=False)
class Weighting:
    """Weights of a factor's scores, which are lengths in metres."""

    kind: Literal["information", "mean"] = "information"
    """"information": a score's curvature at its minimum becomes `amount / sigma^2`, so that marginals are
    covariances. "mean": the loss is `amount` times the mean score (paper eq:final_loss)."""
    amount: float | Float[np.ndarray, "n"] = 1.0
    """"information": the share of a row that counts as independent, in [0, 1], for all or for each. "mean": lambda."""

    def __post_init__(self) -> None:
        checks.settings(self)
        amount = checks.reals("a weighting's amount", self.amount, None)
        if amount.ndim > 1:
            raise FactorError(
                f"a weighting's amount has shape {amount.shape}: one number, or one a row, is due"
            )
        if not (amount >= 0).all() or (self.kind == "information" and not (amount <= 1).all()):
            raise FactorError(f"a weighting of kind {self.kind} cannot have the amount {self.amount}")
        if self.kind == "mean" and amount.ndim:
            raise FactorError("a weighting of kind mean has one amount for all rows")

    def take(self, indices: np.ndarray) -> "Weighting":
        """The weighting of some of the rows."""
        return self if np.ndim(self.amount) == 0 else replace(self, amount=np.asarray(self.amount)[indices])

    def per_row(self, sigma: Float[Tensor, "n"], count: int | None = None) -> Float[Tensor, "n"]:
        """The factor on each row's score; a mean is over `count` rows, by default over these."""
        if self.kind == "information":
            return torch.as_tensor(self.amount, dtype=sigma.dtype) * unit_information_weight(sigma)
        return torch.full_like(sigma, float(self.amount) / max(len(sigma) if count is None else count, 1))


def weighting_of(weighting: Weighting | None, count: int) -> Weighting:
    """The default where there is none; raises FactorError where it is not of so many rows."""
    found = Weighting() if weighting is None else checks.instance("the weighting", weighting, Weighting)
    if np.ndim(found.amount) and len(np.asarray(found.amount)) != count:
        raise FactorError(f"a weighting of {len(np.asarray(found.amount))} rows does not fit {count}")
    return found
