"""Adam on tables of which every step moves a few rows: the codes of the shapes in a batch."""

from collections.abc import Mapping

import torch
from jaxtyping import Float, Int
from torch import Tensor

_FIRST, _SECOND, _EPSILON = 0.9, 0.999, 1e-8


class RowAdam:
    """Kingma & Ba, "Adam", 2015, row by row: a row that is not in a batch stays where it is, and counts its own steps.

    `torch.optim.Adam` would move all rows at every step, and `SparseAdam` corrects its moments by the number of all steps.
    """

    def __init__(self, tables: Mapping[str, Float[Tensor, "s l"]]) -> None:
        self.tables = dict(tables)
        first = next(iter(self.tables.values()))
        self.steps = first.new_zeros(len(first))
        self.moments = {name: (torch.zeros_like(t), torch.zeros_like(t)) for name, t in self.tables.items()}

    def rows(self, index: Int[Tensor, "b"]) -> dict[str, Float[Tensor, "b l"]]:
        """Leaves to differentiate by: the tables' rows."""
        return {name: table[index].requires_grad_() for name, table in self.tables.items()}

    @torch.no_grad()
    def step(self, index: Int[Tensor, "b"], rows: Mapping[str, Float[Tensor, "b l"]], rate: float) -> None:
        """Move the rows against their gradients; each is in a batch once."""
        self.steps[index] += 1
        count = self.steps[index][:, None]
        for name, leaf in rows.items():
            assert leaf.grad is not None
            first, second = self.moments[name]
            first[index] = m = torch.lerp(leaf.grad, first[index], _FIRST)
            second[index] = v = torch.lerp(leaf.grad.square(), second[index], _SECOND)
            m, v = m / (1 - _FIRST**count), v / (1 - _SECOND**count)
            self.tables[name][index] -= rate * m / (v.sqrt() + _EPSILON)

    def state(self) -> dict[str, Tensor]:
        """Everything as named tensors."""
        tensors = {f"table/{name}": table for name, table in self.tables.items()}
        for name, (first, second) in self.moments.items():
            tensors |= {f"first/{name}": first, f"second/{name}": second}
        return tensors | {"steps": self.steps}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Put a state back.

        Raises:
            KeyError, RuntimeError: it is of other tables.
        """
        for name, value in self.state().items():
            value.copy_(state[name])
