"""Layers of a network by oneDNN: in single precision a BLAS can take twice as long.

(MKL's, on processors of another maker.) The products are single precision's either way, added in another order.
"""

from functools import cache
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

Activation = Literal["none", "relu", "silu", "softplus"]
_ACTIVATIONS = {"relu": nn.functional.relu, "silu": nn.functional.silu, "softplus": nn.functional.softplus}


@cache
def _has_onednn() -> bool:
    """Whether the product is to be had: it is torch's own affair, and another release may not offer it, or not so."""
    if not torch.backends.mkldnn.is_available():
        return False
    x, weight, bias = (
        torch.linspace(-1, 1, n, dtype=torch.float32, device="cpu").view(shape)
        for n, shape in ((6, (2, 3)), (12, (4, 3)), (4, (4,)))
    )
    try:
        return all(
            torch.allclose(_product(x, weight, b), nn.functional.linear(x, weight, b), atol=1e-5)
            for b in (bias, None)
        )
    except Exception:  # whatever another release makes of the call
        return False


def affine(
    x: Float[Tensor, "n i"],
    weight: Float[Tensor, "o i"],
    bias: Float[Tensor, "o"] | None = None,
    activation: Activation = "none",
) -> Float[Tensor, "n o"]:
    """`nn.functional.linear`, and an activation of it."""
    plain = x.device.type == "cpu" and x.dtype == torch.float32 and not torch.is_autocast_enabled("cpu")
    if not (plain and x.shape[0] and _has_onednn()):
        return activated(nn.functional.linear(x, weight, bias), activation)
    given = (x, weight) if bias is None else (x, weight, bias)
    if torch.is_grad_enabled() and any(each.requires_grad for each in given):
        return activated(_Affine.apply(x, weight, bias), activation)
    product = _product(x, weight, bias)  # what oneDNN itself would rectify loses NaN
    return product.relu_() if activation == "relu" else activated(product, activation)


def activated(x: Float[Tensor, "n o"], activation: Activation) -> Float[Tensor, "n o"]:
    """The activation of each entry."""
    return x if activation == "none" else _ACTIVATIONS[activation](x)


def through(
    layer: nn.Module,
    x: Float[Tensor, "n i"],
    bias: Float[Tensor, "o"] | None = None,
) -> Float[Tensor, "n o"]:
    """`affine` by a linear layer's weights, and by its own bias unless another is given."""
    assert isinstance(layer, nn.Linear)
    return affine(x, layer.weight, layer.bias if bias is None else bias)


def _product(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")


class _Affine(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(x, weight)
        return _product(x, weight, bias)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (x, weight), d = ctx.saved_tensors, gradients[0].contiguous()
        of_x, of_weight, of_bias = ctx.needs_input_grad
        return (
            affine(d, weight.t().contiguous()) if of_x else None,
            d.t() @ x if of_weight else None,
            d.sum(dim=0) if of_bias else None,
        )
