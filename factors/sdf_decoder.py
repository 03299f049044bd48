"""What every shape decoder offers: the signed distance of canonical points under a shape code, and its derivatives."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from factors.affine import affine
from factors.errors import FactorError

_IN_CACHE = 2048
"""Points that a CPU decodes at once: their activations stay in its cache, which halves the time of a large call."""


class SdfJet(NamedTuple):
    """Signed distances and their first derivatives at n canonical points."""

    value: Float[Tensor, "n"]
    d_point: Float[Tensor, "n 3"]
    d_code: Float[Tensor, "n l"]

    def cpu(self) -> "SdfJet":
        """The same where the factors compute, wherever the decoder is."""
        return SdfJet(self.value.cpu(), self.d_point.cpu(), self.d_code.cpu())


class SdfDecoder(nn.Module, ABC):
    """Signed distance of canonical points, for one or many shape codes.

    A decoder says what it computes of each code beforehand (`_inject`), the distance given that (`_network`),
    and how a gradient with respect to it becomes one with respect to the code (`_code_gradient`).
    """

    config: Any
    """The dataclass that it is made from."""

    @property
    @abstractmethod
    def code_length(self) -> int:
        """Length of the shape code."""

    @property
    @abstractmethod
    def like(self) -> Tensor:
        """A tensor of the decoder's precision, on its device."""

    @abstractmethod
    def _inject(
        self, codes: Float[Tensor, "b l"], owner: Int[Tensor, "n"] | None, n: int
    ) -> dict[str, Float[Tensor, "n w"]]:
        """What each of n points gets from the code that owns it."""

    @abstractmethod
    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "n w"]]
    ) -> Float[Tensor, "n"]:
        """Signed distances, in canonical units."""

    @abstractmethod
    def _code_gradient(self, d_injected: dict[str, Float[Tensor, "n w"]]) -> Float[Tensor, "n l"]:
        """Derivative w.r.t. the code, given that w.r.t. what was injected."""

    def forward(
        self,
        points: Float[Tensor, "n 3"],
        codes: Float[Tensor, "b l"],
        owner: Int[Tensor, "n"] | None = None,
    ) -> Float[Tensor, "n"]:
        """Signed distances, in canonical units, of `points` to the shapes that own them.

        `owner` gives for each point the row of `codes` it belongs to; without it all belong to the one row.

        Raises:
            FactorError: the codes are of another length, or several are given without an owner.
        """
        self._check(codes, owner)
        if torch.is_grad_enabled() or points.is_cuda or len(points) <= _IN_CACHE:
            return self._network(points, self._inject(codes, owner, len(points)))
        return torch.cat(
            [self._network(p, self._inject(codes, o, len(p))) for p, o in _pieces(points, owner)]
        )

    def linearize(
        self,
        points: Float[Tensor, "n 3"],
        codes: Float[Tensor, "b l"],
        owner: Int[Tensor, "n"] | None = None,
    ) -> SdfJet:
        """Signed distances and their derivatives w.r.t. point and code, in one forward and one backward pass.

        Samples are independent, so the gradient of the sum holds each sample's own gradient (paper
        eq:jacobian_code and the first half of eq:jacobian_pose).
        """
        self._check(codes, owner)
        if points.is_cuda or len(points) <= _IN_CACHE:
            return self._linearize(points, codes, owner)
        parts = zip(*(self._linearize(p, codes, o) for p, o in _pieces(points, owner)), strict=True)
        return SdfJet(*(torch.cat(part) for part in parts))

    def _linearize(
        self, points: Float[Tensor, "n 3"], codes: Float[Tensor, "b l"], owner: Int[Tensor, "n"] | None
    ) -> SdfJet:
        with torch.no_grad():
            injected = self._inject(codes.detach(), owner, len(points))
        injected = {name: rows.clone().requires_grad_() for name, rows in injected.items()}
        points = points.detach().requires_grad_()
        with torch.enable_grad():
            value = self._network(points, injected)
            d_point, *d_injected = torch.autograd.grad(value.sum(), [points, *injected.values()])
        with torch.no_grad():
            d_code = self._code_gradient(dict(zip(injected, d_injected, strict=True)))
        return SdfJet(value.detach(), d_point, d_code)

    def _check(self, codes: Tensor, owner: Tensor | None) -> None:
        if codes.ndim != 2 or codes.shape[1] != self.code_length:
            raise FactorError(
                f"codes of shape {tuple(codes.shape)} do not fit this decoder: it takes (b, {self.code_length})"
            )
        if owner is None and len(codes) != 1:
            raise FactorError(f"{len(codes)} codes were given: `owner` must say whose each point is")


def _pieces(
    points: Float[Tensor, "n 3"], owner: Int[Tensor, "n"] | None
) -> Iterator[tuple[Float[Tensor, "m 3"], Int[Tensor, "m"] | None]]:
    for i in range(0, len(points), _IN_CACHE):
        yield points[i : i + _IN_CACHE], None if owner is None else owner[i : i + _IN_CACHE]


class LinearInjection(SdfDecoder):
    """A network that the code enters linearly before an activation.

    Its contribution is computed once a shape and not once a point; its gradient comes back through the same door.
    """

    from_code: nn.ModuleDict
    """By the layer at which the code enters: `nn.Linear` without bias."""

    def _inject(
        self, codes: Float[Tensor, "b l"], owner: Int[Tensor, "n"] | None, n: int
    ) -> dict[str, Float[Tensor, "n w"]]:
        if owner is None:
            return {layer: linear(codes).expand(n, -1) for layer, linear in self.from_code.items()}
        return {layer: linear(codes)[owner] for layer, linear in self.from_code.items()}

    def _code_gradient(self, d_injected: dict[str, Float[Tensor, "n w"]]) -> Float[Tensor, "n l"]:
        weights = {layer: self.get_parameter(f"from_code.{layer}.weight") for layer in d_injected}
        parts = [affine(rows, weights[layer].t().contiguous()) for layer, rows in d_injected.items()]
        return sum(parts[1:], start=parts[0])
