"""The DeepSDF decoder: a shape code and a canonical point give a signed distance.

Park et al., "DeepSDF", CVPR 2019 (paper eq:deepsdf), with smooth activations, so that the Jacobians that
the factors use are continuous.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from factors.errors import FactorError

_ACTIVATIONS = {"silu": nn.functional.silu, "relu": nn.functional.relu, "softplus": nn.functional.softplus}


@dataclass(frozen=True)
class DecoderConfig:
    """Shape of the network."""

    code_length: int = 64
    """Length of the shape code."""
    width: int = 256
    """Units of every hidden layer."""
    depth: int = 5
    """Number of hidden layers."""
    skip: int = 2
    """The hidden layer at which code and point enter a second time; 0 for none."""
    octaves: int = 0
    """Number of sine/cosine pairs an axis, at frequencies pi * 2^k, given beside the point itself."""
    activation: Literal["silu", "relu", "softplus"] = "silu"
    """The hidden units' non-linearity."""


class SdfJet(NamedTuple):
    """Signed distances and their first derivatives at n canonical points."""

    value: Float[Tensor, "n"]
    d_point: Float[Tensor, "n 3"]
    d_code: Float[Tensor, "n l"]


class Decoder(nn.Module):
    """Signed distance of canonical points, for one or many shape codes.

    The code enters linearly before an activation, so its contribution is computed once a shape and not once
    a point; its gradient comes back through the same door.
    """

    def __init__(self, config: DecoderConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DecoderConfig()
        if not 0 <= config.skip < config.depth:
            raise FactorError(f"the skip layer {config.skip} is not one of the {config.depth} hidden layers")
        features = 3 + 6 * config.octaves
        entries = [0] if config.skip == 0 else [0, config.skip]
        self.from_code = nn.ModuleDict(
            {str(i): nn.Linear(config.code_length, config.width, bias=False) for i in entries}
        )
        self.from_point = nn.ModuleDict({str(i): nn.Linear(features, config.width) for i in entries})
        self.hidden = nn.ModuleList(
            nn.Linear(config.width, config.width, bias=i not in entries) for i in range(1, config.depth)
        )
        self.output = nn.Linear(config.width, 1)
        self.frequencies: Tensor
        self.register_buffer("frequencies", torch.pi * 2.0 ** torch.arange(config.octaves), persistent=False)

    @property
    def code_length(self) -> int:
        return self.config.code_length

    def forward(
        self,
        points: Float[Tensor, "n 3"],
        codes: Float[Tensor, "b l"],
        owner: Int[Tensor, "n"] | None = None,
    ) -> Float[Tensor, "n"]:
        """Signed distances, in canonical units, of `points` to the shapes that own them.

        `owner` gives for each point the row of `codes` it belongs to; without it all belong to the one row.
        """
        return self._network(points, self._inject(codes, owner, len(points)))

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
        with torch.no_grad():
            injected = self._inject(codes.detach(), owner, len(points))
        injected = {layer: rows.clone().requires_grad_() for layer, rows in injected.items()}
        points = points.detach().requires_grad_()
        with torch.enable_grad():
            value = self._network(points, injected)
            d_point, *d_injected = torch.autograd.grad(value.sum(), [points, *injected.values()])
        weights = [self.get_parameter(f"from_code.{layer}.weight").detach() for layer in injected]
        d_code = torch.stack([rows @ weight for rows, weight in zip(d_injected, weights, strict=True)]).sum(
            dim=0
        )
        return SdfJet(value.detach(), d_point, d_code)

    def _inject(
        self, codes: Float[Tensor, "b l"], owner: Int[Tensor, "n"] | None, n: int
    ) -> dict[str, Float[Tensor, "n w"]]:
        if codes.ndim != 2 or codes.shape[1] != self.code_length:
            raise FactorError(
                f"codes of shape {tuple(codes.shape)} do not fit this decoder: it takes (b, {self.code_length})"
            )
        if owner is None:
            if len(codes) != 1:
                raise FactorError(f"{len(codes)} codes were given: `owner` must say whose each point is")
            return {layer: linear(codes).expand(n, -1) for layer, linear in self.from_code.items()}
        return {layer: linear(codes)[owner] for layer, linear in self.from_code.items()}

    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "n w"]]
    ) -> Float[Tensor, "n"]:
        activation = _ACTIVATIONS[self.config.activation]
        features = self._features(points)
        h = activation(self.from_point["0"](features) + injected["0"])
        for i, linear in enumerate(self.hidden, start=1):
            pre = linear(h)
            if str(i) in injected:
                pre = pre + self.from_point[str(i)](features) + injected[str(i)]
            h = activation(pre)
        return self.output(h).squeeze(-1)

    def _features(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n f"]:
        if self.config.octaves == 0:
            return points
        angles = (points[:, :, None] * self.frequencies).flatten(1)
        return torch.cat([points, angles.sin(), angles.cos()], dim=-1)
