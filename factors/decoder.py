"""The DeepSDF decoder: a shape code and a canonical point give a signed distance.

Park et al., "DeepSDF", CVPR 2019 (paper eq:deepsdf). With ReLU, which the shipped priors have, the Jacobians that the
factors use jump between pieces; smooth activations are there for those who want them continuous.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from factors.affine import affine, through
from factors.errors import FactorError
from factors.sdf_decoder import LinearInjection, SdfJet

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


class Decoder(LinearInjection):
    """Layers of one width; code and point enter at the first and, a second time, at the skip layer."""

    config: DecoderConfig

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

    @property
    def like(self) -> Tensor:
        return self.output.weight

    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "n w"]]
    ) -> Float[Tensor, "n"]:
        activation = _ACTIVATIONS[self.config.activation]
        features = self._features(points)
        h = activation(through(self.from_point["0"], features) + injected["0"])
        for i, linear in enumerate(self.hidden, start=1):
            pre = through(linear, h)
            if str(i) in injected:
                pre = pre + through(self.from_point[str(i)], features) + injected[str(i)]
            h = activation(pre)
        return self.output(h).squeeze(-1)

    def _linearize(
        self, points: Float[Tensor, "n 3"], codes: Float[Tensor, "b l"], owner: Int[Tensor, "n"] | None
    ) -> SdfJet:
        """By hand where the activation's derivative is seen from its value: autograd takes half as long again."""
        if self.config.activation != "relu" or type(self)._network is not Decoder._network:
            return super()._linearize(points, codes, owner)
        with torch.no_grad():
            features, injected = self._features(points), self._inject(codes, owner, len(points))
            layers: list[Tensor] = []
            for i in range(self.config.depth):
                pre = through(self.hidden[i - 1], layers[-1]) if i else points.new_zeros(())
                if (entry := str(i)) in injected:
                    pre = pre + through(self.from_point[entry], features).add_(injected[entry])
                layers.append(pre.relu_())
            value = self.output(layers[-1]).squeeze(-1)
            d_layer, d_features, d_injected = self.output.weight.expand(len(points), -1), 0.0, {}
            for i in reversed(range(self.config.depth)):
                d_layer = torch.ops.aten.threshold_backward(d_layer, layers[i], 0)
                if (entry := str(i)) in injected:
                    d_features = d_features + _back(self.from_point[entry], d_layer)
                    d_injected[entry] = d_layer
                if i:
                    d_layer = _back(self.hidden[i - 1], d_layer)
            d_point = self._point_gradient(features, torch.as_tensor(d_features))
            return SdfJet(value, d_point, self._code_gradient(d_injected))

    def _point_gradient(
        self, features: Float[Tensor, "n f"], d_features: Float[Tensor, "n f"]
    ) -> Float[Tensor, "n 3"]:
        """Derivative w.r.t. the point, given that w.r.t. its features."""
        if self.config.octaves == 0:
            return d_features
        rest = [3 * self.config.octaves] * 2
        _, sin, cos = features.split([3, *rest], dim=1)
        d_point, d_sin, d_cos = d_features.split([3, *rest], dim=1)
        d_angle = (d_sin * cos - d_cos * sin).unflatten(1, (3, -1))
        return d_point + (d_angle * self.frequencies).sum(dim=2)

    def _features(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n f"]:
        if self.config.octaves == 0:
            return points
        angles = (points[:, :, None] * self.frequencies).flatten(1)
        return torch.cat([points, angles.sin(), angles.cos()], dim=-1)


def _back(layer: nn.Module, d_output: Float[Tensor, "n o"]) -> Float[Tensor, "n i"]:
    """Derivative w.r.t. what a linear layer was given."""
    assert isinstance(layer, nn.Linear)
    return affine(d_output, layer.weight.t().contiguous())
