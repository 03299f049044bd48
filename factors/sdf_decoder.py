"""What every shape decoder offers: the signed distance of canonical points under a shape code, and its derivatives."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor, nn

from factors.affine import affine
from factors.errors import FactorError

_IN_CACHE = 2048
"""Points that a CPU decodes at once: their activations stay in its cache, which halves the time of a large call."""
_ROWS = 64
"""Of which a CPU decodes multiples: oneDNN compiles, and keeps, code for every number of rows it meets."""


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

    A decoder says what enters its network of each code (`_enter`) and how that moves with the code (`_d_enter`), both
    computed once a shape and not once a point, and the distance given that (`_network`).
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
    def _enter(self, codes: Float[Tensor, "b l"]) -> dict[str, Float[Tensor, "b w"]]:
        """What enters the network of each code, by where."""

    @abstractmethod
    def _d_enter(self, codes: Float[Tensor, "b l"]) -> dict[str, Float[Tensor, "c w l"]]:
        """Derivative of `_enter` w.r.t. each code; one for all where it does not depend on them."""

    @abstractmethod
    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "m w"]]
    ) -> Float[Tensor, "n"]:
        """Signed distances, in canonical units; m is n, or one for all points."""

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
        if owner is not None and (order := _grouping(owner)) is not None:
            return self(points[order], codes, owner[order])[order.argsort()]
        entered = _each_alone(self._enter, codes)
        at_once = len(points) if torch.is_grad_enabled() else _IN_CACHE
        parts = [self._network(p, _owned(entered, o))[:n] for n, p, o in _pieces(points, owner, at_once)]
        return parts[0] if len(parts) == 1 else torch.cat(parts)

    def in_blocks(self, points: Float[Tensor, "b k 3"], codes: Float[Tensor, "b l"]) -> Float[Tensor, "b k"]:
        """Signed distances of as many points of each shape: what training asks for."""
        b, k = points.shape[:2]
        injected = {
            layer: rows[:, None].expand(-1, k, -1).reshape(b * k, -1)
            for layer, rows in self._enter(codes).items()
        }
        return self._network(points.flatten(0, 1), injected).view(b, k)

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
        if owner is not None and (order := _grouping(owner)) is not None:
            jet = self.linearize(points[order], codes, owner[order])
            return SdfJet(*(part[order.argsort()] for part in jet))
        with torch.no_grad():
            entered = _each_alone(self._enter, codes.detach())
            d_entered = _each_alone(self._d_enter, codes.detach())
            to_code = {layer: each.transpose(1, 2).contiguous() for layer, each in d_entered.items()}
            parts = []
            for n, p, o in _pieces(points, owner, _IN_CACHE):
                value, d_point, d_injected = self._linearize(p.detach(), _owned(entered, o))
                d_code, *more = [_code_gradient(d_injected[layer], to_code[layer], o) for layer in to_code]
                for each in more:
                    d_code += each
                parts.append([each[:n] for each in (value, d_point, d_code)])
        return SdfJet(*(part[0] if len(parts) == 1 else torch.cat(part) for part in zip(*parts, strict=True)))

    def gradient(self, points: Float[Tensor, "n 3"], code: Float[Tensor, "l"]) -> Float[Tensor, "n 3"]:
        """Derivative of the signed distance of points of one shape w.r.t. them, which `linearize` gives too and for more."""
        self._check(code[None], None)
        with torch.no_grad():
            entered = self._enter(code.detach()[None])
            parts = [
                self._linearize(p.detach(), entered)[1][:n] for n, p, _ in _pieces(points, None, _IN_CACHE)
            ]
        return parts[0] if len(parts) == 1 else torch.cat(parts)

    def _linearize(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "m w"]]
    ) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"], dict[str, Float[Tensor, "n w"]]]:
        """The network's values, and their derivatives w.r.t. points and what was injected."""
        n = len(points)
        injected = {name: rows.expand(n, -1).clone().requires_grad_() for name, rows in injected.items()}
        points = points.clone().requires_grad_()
        with torch.enable_grad():
            value = self._network(points, injected)
            d_point, *d_injected = torch.autograd.grad(value.sum(), [points, *injected.values()])
        return value.detach(), d_point, dict(zip(injected, d_injected, strict=True))

    def _check(self, codes: Tensor, owner: Tensor | None) -> None:
        if codes.ndim != 2 or codes.shape[1] != self.code_length:
            raise FactorError(
                f"codes of shape {tuple(codes.shape)} do not fit this decoder: it takes (b, {self.code_length})"
            )
        if owner is None and len(codes) != 1:
            raise FactorError(f"{len(codes)} codes were given: `owner` must say whose each point is")


def _each_alone(
    of: Callable[[Float[Tensor, "b l"]], dict[str, Shaped[Tensor, "b ..."]]], codes: Float[Tensor, "b l"]
) -> dict[str, Shaped[Tensor, "b ..."]]:
    """`of` each code, on a CPU to the bit what it gives of that one alone: products round by how many rows they have."""
    if codes.is_cuda or len(codes) == 1:
        return of(codes)
    rows = [of(code[None]) for code in codes]
    return {layer: torch.cat([row[layer] for row in rows]) for layer in rows[0]}


def _grouping(owner: Int[Tensor, "n"]) -> Int[Tensor, "n"] | None:
    """The order in which each shape's points follow each other; None where they do, or no CPU decodes them."""
    return None if owner.is_cuda or bool((owner.diff() >= 0).all()) else owner.argsort(stable=True)


def _pieces(
    points: Float[Tensor, "n 3"], owner: Int[Tensor, "n"] | None, at_once: int
) -> Iterator[tuple[int, Float[Tensor, "m 3"], "Int[Tensor, 'm'] | int | None"]]:
    """What is decoded at once: how many points, they with more of the last one, and whose they are: each point's, or all."""
    if points.is_cuda:
        yield len(points), points, owner
        return
    runs = [(len(points), None if owner is None else 0)]
    if owner is not None and len(points):
        owners, counts = owner.unique_consecutive(return_counts=True)
        runs = [*zip(counts.tolist(), owners.tolist(), strict=True)]
    start = 0
    for count, whose in runs:
        for i in range(start, start + max(count, 1), max(at_once, 1)):
            piece = points[i : min(i + at_once, start + count)]
            yield len(piece), _padded(piece), whose
        start += count


def _padded(rows: Shaped[Tensor, "n ..."]) -> Shaped[Tensor, "m ..."]:
    """With its last row again and again behind."""
    return torch.cat([rows, rows[-1:].expand(-len(rows) % _ROWS, *rows.shape[1:])])


def _owned(
    entered: dict[str, Float[Tensor, "b w"]], owner: "Int[Tensor, 'n'] | int | None"
) -> dict[str, Float[Tensor, "m w"]]:
    """What the code of each point gave, or the one code of all points."""
    if owner is None:
        return entered
    rows = slice(owner, owner + 1) if isinstance(owner, int) else owner
    return {layer: each[rows] for layer, each in entered.items()}


def _code_gradient(
    d_rows: Float[Tensor, "n w"], to_code: Float[Tensor, "c l w"], owner: "Int[Tensor, 'n'] | int | None"
) -> Float[Tensor, "n l"]:
    """Chain rule, each point by its own code's derivative; a tensor of its own."""
    if len(to_code) == 1 or not isinstance(owner, Tensor):
        return affine(d_rows, to_code[owner if isinstance(owner, int) and len(to_code) > 1 else 0])
    result = d_rows.new_empty(len(d_rows), to_code.shape[1])
    for i in owner.unique().tolist():
        own = owner == i
        rows = d_rows[own]
        result[own] = affine(_padded(rows), to_code[i])[: len(rows)]
    return result


class LinearInjection(SdfDecoder):
    """A network that the code enters linearly before an activation."""

    from_code: nn.ModuleDict
    """By the layer at which the code enters: `nn.Linear` without bias."""

    def _enter(self, codes: Float[Tensor, "b l"]) -> dict[str, Float[Tensor, "b w"]]:
        return {layer: linear(codes) for layer, linear in self.from_code.items()}

    def _d_enter(self, codes: Float[Tensor, "b l"]) -> dict[str, Float[Tensor, "1 w l"]]:
        return {layer: self.get_parameter(f"from_code.{layer}.weight")[None] for layer in self.from_code}
