"""How much a row of a score counts: as statistical information, or as the paper's fixed weight."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from factors.errors import FactorError
from factors.score import unit_information_weight


@dataclass(frozen=True)
class Weighting:
    """Weights of a factor's scores, which are lengths in metres."""

    kind: Literal["information", "mean"] = "information"
    """"information": a score's curvature at its minimum becomes `amount / sigma^2`, so that marginals are
    covariances. "mean": the loss is `amount` times the mean score (paper eq:final_loss)."""
    amount: float = 1.0
    """"information": the share of the rows that counts as independent, in (0, 1]. "mean": lambda."""

    def __post_init__(self) -> None:
        if not self.amount >= 0 or (self.kind == "information" and self.amount > 1):
            raise FactorError(f"a weighting of kind {self.kind} cannot have the amount {self.amount}")

    def per_row(self, sigma: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """The factor on each row's score."""
        if self.kind == "information":
            return self.amount * unit_information_weight(sigma)
        return torch.full_like(sigma, self.amount / max(len(sigma), 1))
