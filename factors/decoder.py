"""The DeepSDF decoder: a shape code and a canonical point give a signed distance.

Park et al., "DeepSDF", CVPR 2019 (paper eq:deepsdf). With ReLU, which the shipped priors have, the Jacobians that the
factors use jump between pieces; smooth activations are there for those who want them continuous.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from factors import checks
from factors.affine import activated, affine, through
from factors.errors import FactorError
from factors.sdf_decoder import LinearInjection


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
    mapping: int = 0
    """Units of the two layers of a network that the code passes once a shape, before it enters at every hidden layer;
    without any it enters as it is, at the first and the skip layer."""

    def __post_init__(self) -> None:
        """Raises FactorError where there is no such network, or one larger than any that was trained."""
        units = checks.Range(1, 8192)
        checks.settings(
            self, code_length=units, width=units, depth=checks.Range(1, 64), skip=checks.Range(0, 63),
            octaves=checks.Range(0, 16), mapping=checks.Range(0, 8192),
        )  # fmt: skip


class Decoder(LinearInjection):
    """Layers of one width; code and point enter at the first and, a second time, at the skip layer."""

    config: DecoderConfig

    def __init__(self, config: DecoderConfig | None = None) -> None:
        super().__init__()
        self.config = config = checks.settings_or_default(config, DecoderConfig)
        if not 0 <= config.skip < config.depth:
            raise FactorError(f"the skip layer {config.skip} is not one of the {config.depth} hidden layers")
        features = 3 + 6 * config.octaves
        entries = [0] if config.skip == 0 else [0, config.skip]
        mapped, m = range(config.depth) if config.mapping else entries, config.mapping
        self.from_code = nn.ModuleDict(
            {str(i): nn.Linear(m or config.code_length, config.width, bias=False) for i in mapped}
        )
        self.mapping = nn.ModuleList([nn.Linear(config.code_length, m), nn.Linear(m, m)] if m else [])
        self.from_point = nn.ModuleDict({str(i): nn.Linear(features, config.width) for i in entries})
        self.hidden = nn.ModuleList(
            nn.Linear(config.width, config.width, bias=i not in entries) for i in range(1, config.depth)
        )
        self.output = nn.Linear(config.width, 1)
        self.frequencies: Tensor
        frequencies = [math.pi * 2.0**octave for octave in range(config.octaves)]
        self.register_buffer("frequencies", torch.tensor(frequencies), persistent=False)

    @property
    def code_length(self) -> int:
        return self.config.code_length

    @property
    def like(self) -> Tensor:
        return self.output.weight

    def _enter(self, codes: Float[Tensor, "b l"]) -> dict[str, Float[Tensor, "b w"]]:
        for linear in self.mapping:
            codes = nn.functional.silu(linear(codes))
        return super()._enter(codes)

    def _d_enter(self, codes: Float[Tensor, "b l"]) -> dict[str, Float[Tensor, "c w l"]]:
        h, d = codes, torch.eye(self.code_length).to(codes)[None]
        for linear in self.mapping:
            assert isinstance(linear, nn.Linear)
            pre = linear(h)
            slope = pre.sigmoid() * (1 + pre * (1 - pre.sigmoid()))
            h, d = nn.functional.silu(pre), slope[..., None] * (linear.weight @ d)
        return {layer: weight @ d for layer, weight in super()._d_enter(h).items()}

    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "m w"]]
    ) -> Float[Tensor, "n"]:
        *_, last = self._layers(self._features(points), injected)
        return through(self.output, last).squeeze(-1)

    def _layers(
        self, features: Float[Tensor, "n f"], injected: dict[str, Float[Tensor, "m w"]]
    ) -> Iterator[Float[Tensor, "n w"]]:
        """Each hidden layer's values."""
        h, activation = None, self.config.activation
        for layer in range(self.config.depth):
            given = [] if h is None else [(self.hidden[layer - 1], h)]
            if (entry := str(layer)) in self.from_point:
                given.append((self.from_point[entry], features))
            linears = [(linear, x) for linear, x in given if isinstance(linear, nn.Linear)]
            biases: list[Tensor] = [linear.bias for linear, _ in linears if linear.bias is not None]
            rows = injected.get(entry)
            if rows is not None and len(rows) == 1:  # the same for all points: a bias more
                biases, rows = [*biases, rows[0]], None
            bias = torch.stack(biases).sum(dim=0) if len(biases) > 1 else biases[0] if biases else None
            (linear, x), *others = linears
            if not others and rows is None:
                h = affine(x, linear.weight, bias, activation)
            else:
                h = affine(x, linear.weight, bias)
                for linear, x in others:
                    h += affine(x, linear.weight)  # in place: it is a product of its own
                h = activated(h if rows is None else h + rows, activation)
            yield h

    def _linearize(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "m w"]]
    ) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"], dict[str, Float[Tensor, "n w"]]]:
        """By hand where the activation's derivative is seen from its value: autograd takes half as long again."""
        if self.config.activation != "relu" or type(self)._network is not Decoder._network:
            return super()._linearize(points, injected)
        features = self._features(points)
        layers = [*self._layers(features, injected)]
        value = through(self.output, layers[-1]).squeeze(-1)
        d_layer, d_features, d_injected = self.output.weight.expand(len(points), -1), 0.0, {}
        for i in reversed(range(self.config.depth)):
            d_layer = torch.ops.aten.threshold_backward(d_layer, layers[i], 0)
            if (entry := str(i)) in self.from_point:
                d_features = d_features + _back(self.from_point[entry], d_layer)
            if entry in injected:
                d_injected[entry] = d_layer
            if i:
                d_layer = _back(self.hidden[i - 1], d_layer)
        return value, self._point_gradient(features, torch.as_tensor(d_features)), d_injected

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
