"""The DeepSDF decoder: a shape code and a canonical point give a signed distance.

Park et al., "DeepSDF", CVPR 2019 (paper eq:deepsdf). With ReLU, which the shipped priors have, the Jacobians that the
factors use jump between pieces; smooth activations are there for those who want them continuous.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from factors.affine import through
from factors.errors import FactorError
from factors.sdf_decoder import LinearInjection

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

    def _features(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n f"]:
        if self.config.octaves == 0:
            return points
        angles = (points[:, :, None] * self.frequencies).flatten(1)
        return torch.cat([points, angles.sin(), angles.cos()], dim=-1)
