"""Layers of a network whose weights are given, by oneDNN: in single precision a BLAS can take twice as long.

(MKL's, on processors of another maker.) The products are single precision's either way, added in another order.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

_ONEDNN = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")


def affine(
    x: Float[Tensor, "n i"], weight: Float[Tensor, "o i"], bias: Float[Tensor, "o"] | None = None
) -> Float[Tensor, "n o"]:
    """`nn.functional.linear`, differentiable in `x`; in weight and bias too where one of these is being trained."""
    trained = weight.requires_grad or (bias is not None and bias.requires_grad)
    if trained or not _ONEDNN or x.device.type != "cpu" or x.dtype != torch.float32 or not len(x):
        return nn.functional.linear(x, weight, bias)
    if torch.is_grad_enabled() and x.requires_grad:
        return _Affine.apply(x, weight, bias)
    return _product(x, weight, bias)


def through(
    layer: nn.Module, x: Float[Tensor, "n i"], bias: Float[Tensor, "o"] | None = None
) -> Float[Tensor, "n o"]:
    """`affine` by a linear layer's weights, and by its own bias unless another is given."""
    assert isinstance(layer, nn.Linear)
    return affine(x, layer.weight, layer.bias if bias is None else bias)


def _product(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")


class _Affine(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(weight)
        return _product(x, weight, bias)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        (weight,) = ctx.saved_tensors
        return affine(gradients[0].contiguous(), weight.t().contiguous()), None, None
