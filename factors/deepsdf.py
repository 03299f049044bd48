"""The network of the DeepSDF release: ReLU layers, inputs concatenated again on the way, tanh at the end.

Park et al., "DeepSDF", CVPR 2019, as its public implementation (MIT) lays it out in `NetworkSpecs`.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from factors.affine import through
from factors.errors import FactorError
from factors.sdf_decoder import LinearInjection


@dataclass(frozen=True)
class DeepSdfConfig:
    """Shape of the network; training-time settings (dropout, weight norm) leave nothing to configure."""

    code_length: int
    """Length of the shape code."""
    dims: tuple[int, ...]
    """Width of the input of every layer after the first, as `NetworkSpecs` counts it: with what is concatenated."""
    latent_in: tuple[int, ...] = ()
    """Layers whose input is concatenated with code and point."""
    xyz_in_all: bool = False
    """Whether the point is concatenated to every other layer's input but the first's."""
    layer_norm: tuple[int, ...] = ()
    """Layers with a layer norm before the activation."""
    tanh: int = 1
    """Times that tanh is applied to the output: once by every checkpoint, twice with `use_tanh`."""
    unit: float = 1.0
    """Network units in one canonical unit: points are multiplied by it, distances divided."""


class DeepSdfDecoder(LinearInjection):
    """Signed distance of the DeepSDF release's network, its weight norm folded, in canonical units.

    Concatenating code and point to a layer's input is adding their own linear images to its output: each layer
    is split into what it makes of the layer before, of the point and of the code.
    """

    config: DeepSdfConfig

    def __init__(self, config: DeepSdfConfig) -> None:
        super().__init__()
        self.config = config
        count = len(config.dims) + 1
        outside = [i for i in (*config.latent_in, *config.layer_norm) if not 0 <= i < count]
        if not config.dims or outside or 0 in config.latent_in:
            raise FactorError(
                f"latent_in {config.latent_in} and layer_norm {config.layer_norm} do not fit {count} layers"
            )
        if not (config.unit > 0 and config.tanh in (0, 1, 2) and config.code_length > 0):
            raise FactorError(
                f"unit {config.unit} and code length {config.code_length} must be positive, "
                f"tanh {config.tanh} 0, 1 or 2"
            )
        sizes = [layer_sizes(config, i) for i in range(count)]
        if bad := [i for i, size in enumerate(sizes) if size.inputs < (i > 0) or size.outputs < 1]:
            raise FactorError(f"dims {config.dims} leave no room for what is concatenated at layers {bad}")
        self.from_code = nn.ModuleDict(
            {
                str(i): nn.Linear(config.code_length, size.outputs, bias=False)
                for i, size in enumerate(sizes)
                if size.code
            }
        )
        self.from_point = nn.ModuleDict(
            {str(i): nn.Linear(3, size.outputs, bias=False) for i, size in enumerate(sizes) if size.point}
        )
        self.hidden = nn.ModuleDict(
            {str(i): nn.Linear(size.inputs, size.outputs, bias=False) for i, size in enumerate(sizes) if i}
        )
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(size.outputs)) for size in sizes])
        self.norm = nn.ModuleDict({str(i): nn.LayerNorm(sizes[i].outputs) for i in config.layer_norm})

    @property
    def code_length(self) -> int:
        return self.config.code_length

    @property
    def like(self) -> Tensor:
        return self.bias[0]

    def _network(
        self, points: Float[Tensor, "n 3"], injected: dict[str, Float[Tensor, "m w"]]
    ) -> Float[Tensor, "n"]:
        points = points * self.config.unit
        h = points
        last = len(self.bias) - 1
        for i, bias in enumerate(self.bias):
            layer = str(i)
            pre = through(self.hidden[layer], h, bias) if i else bias
            if layer in self.from_point:
                pre = pre + through(self.from_point[layer], points)
            if layer in injected:
                pre = pre + injected[layer]
            if layer in self.norm:
                pre = self.norm[layer](pre)
            h = pre if i == last else nn.functional.relu(pre)
        for _ in range(self.config.tanh):
            h = h.tanh()
        return h.squeeze(-1) / self.config.unit


@dataclass(frozen=True)
class LayerSize:
    """What a layer takes and gives."""

    inputs: int
    """From the layer before."""
    outputs: int
    code: bool
    """Whether the code is concatenated."""
    point: bool
    """Whether the point is."""


def layer_sizes(config: DeepSdfConfig, layer: int) -> LayerSize:
    """Sizes of one layer: what a later layer's input gets concatenated, the layer before it leaves out."""
    given = config.code_length + 3
    widths = (given, *config.dims, 1)
    code = layer == 0 or layer in config.latent_in
    point = code or config.xyz_in_all
    inputs = 0 if layer == 0 else widths[layer] - (given if code else 3 if point else 0)
    following = layer + 1
    if following in config.latent_in:
        outputs = widths[following] - given
    elif config.xyz_in_all and following < len(widths) - 1:
        outputs = widths[following] - 3
    else:
        outputs = widths[following]
    return LayerSize(inputs, outputs, code, point)
