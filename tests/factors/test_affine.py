"""Layers by oneDNN: the product's definition, its gradients, and weights that are trained."""

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given
from torch import nn

from factors import affine as affine_module
from factors.affine import affine


def drawn(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@given(n=st.integers(0, 40), i=st.integers(1, 70), o=st.integers(1, 70), biased=st.booleans())
def test_it_is_the_product(n: int, i: int, o: int, biased: bool) -> None:
    x, weight, bias = drawn(0, n, i), drawn(1, o, i), drawn(2, o) if biased else None
    exact = x.double() @ weight.double().T + (bias.double() if bias is not None else 0.0)
    assert affine(x, weight, bias).shape == (n, o)
    torch.testing.assert_close(affine(x, weight, bias).double(), exact, rtol=1e-5, atol=1e-4)


@given(n=st.integers(1, 40), name=st.sampled_from(["none", "relu", "silu", "softplus"]), biased=st.booleans())
def test_an_activation_is_of_the_product(n: int, name: affine_module.Activation, biased: bool) -> None:
    x, weight, bias, upstream = (
        drawn(0, n, 17),
        drawn(1, 9, 17),
        drawn(2, 9) if biased else None,
        drawn(3, n, 9),
    )
    function = {
        "none": lambda y: y,
        "relu": torch.relu,
        "silu": nn.functional.silu,
        "softplus": nn.functional.softplus,
    }
    given_x, true_x = x.clone().requires_grad_(), x.clone().requires_grad_()
    true = function[name](nn.functional.linear(true_x, weight, bias))
    torch.testing.assert_close(affine(x, weight, bias, name), true.detach(), rtol=1e-4, atol=1e-5)
    (found,) = torch.autograd.grad((affine(given_x, weight, bias, name) * upstream).sum(), given_x)
    (exact,) = torch.autograd.grad((true * upstream).sum(), true_x)
    torch.testing.assert_close(found, exact, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["none", "relu", "silu", "softplus"])
def test_what_is_no_number_stays_none(name: affine_module.Activation) -> None:
    x, weight = drawn(0, 64, 17), drawn(1, 9, 17)
    x[5] = torch.nan
    found = affine(x, weight, None, name)
    assert found[5].isnan().all()
    assert found.isnan().sum() == 9


def test_single_precision_alone_takes_the_short_cut() -> None:
    x, weight = drawn(0, 20, 256).double(), drawn(1, 30, 256).double()
    torch.testing.assert_close(affine(x, weight), x @ weight.T, rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize("through", [True, False])
def test_the_gradient_is_the_derivative_of_the_product(through: bool) -> None:
    x = drawn(0, 7, 5).requires_grad_()
    weight, upstream = drawn(1, 3, 5), drawn(2, 7, 3)
    layer = affine(x, weight) if through else affine(x.relu(), weight)
    (found,) = torch.autograd.grad((layer * upstream).sum(), x)
    exact = upstream @ weight
    torch.testing.assert_close(found, exact if through else exact * (x > 0))


def test_gradients_of_gradients_pass() -> None:
    x, weight = drawn(0, 7, 5).requires_grad_(), drawn(1, 3, 5)
    value = (affine(x, weight) ** 2).sum()
    (first,) = torch.autograd.grad(value, x, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), x)
    torch.testing.assert_close(second, (2 * weight.T @ weight).sum(0).expand(7, 5))


def test_weights_that_are_trained_get_their_gradient() -> None:
    layer, x, upstream = nn.Linear(5, 3), drawn(0, 7, 5).requires_grad_(), drawn(2, 7, 3)
    (affine(x, layer.weight, layer.bias) * upstream).sum().backward()
    found = [each.grad for each in (x, layer.weight, layer.bias)]
    exact = [upstream @ layer.weight.detach(), upstream.T @ x.detach(), upstream.sum(0)]
    for each, value in zip(found, exact, strict=True):
        assert each is not None
        torch.testing.assert_close(each, value)


def test_a_layer_is_the_same_whether_it_is_trained_or_not() -> None:
    layer, x = nn.Linear(50, 30), drawn(0, 7, 50)
    trained = affine(x, layer.weight, layer.bias).detach()
    assert torch.equal(trained, affine(x, layer.weight.detach(), layer.bias.detach()))


def test_autocast_has_its_way() -> None:
    x, weight = drawn(0, 7, 50), drawn(1, 30, 50)
    with torch.autocast("cpu", torch.bfloat16):
        assert affine(x, weight).dtype == torch.bfloat16


def missing(*_):
    raise AttributeError("'_OpNamespace' 'mkldnn' object has no attribute '_linear_pointwise'")


def refused(*_):
    raise ValueError("another count of arguments is due")


def changed(x, weight, bias):
    return x @ weight.T  # forgets the bias


@pytest.mark.parametrize("product", [missing, refused, changed])
def test_without_the_operator_layers_are_torch_s_own(product, monkeypatch) -> None:
    """A private operator may go or change with a release of torch."""
    monkeypatch.setattr(affine_module, "_product", product)
    affine_module._has_onednn.cache_clear()
    try:
        x, weight, bias = (
            drawn(i, *shape).requires_grad_() for i, shape in enumerate(((7, 5), (3, 5), (3,)))
        )
        assert not affine_module._has_onednn()
        found = affine(x, weight, bias)
        torch.testing.assert_close(found, nn.functional.linear(x, weight, bias))
        torch.testing.assert_close(
            torch.autograd.grad(found.sum(), [x, weight, bias]),
            torch.autograd.grad(nn.functional.linear(x, weight, bias).sum(), [x, weight, bias]),
        )
    finally:
        affine_module._has_onednn.cache_clear()


def test_whether_the_operator_is_there_does_not_depend_on_who_asks_first() -> None:
    expected = affine_module._has_onednn()
    affine_module._has_onednn.cache_clear()
    torch.set_default_dtype(torch.float64)
    try:
        assert affine_module._has_onednn() == expected
    finally:
        torch.set_default_dtype(torch.float32)
        affine_module._has_onednn.cache_clear()
