"""The DeepSDF release's network against one written as the paper draws it, by concatenation."""

import pytest
import torch
from torch import nn

from factors.deepsdf import DeepSdfConfig, DeepSdfDecoder
from factors.errors import FactorError

LENGTH = 4
CONFIGS = [
    DeepSdfConfig(LENGTH, (16, 16)),
    DeepSdfConfig(LENGTH, (24, 20, 24, 16), latent_in=(2,)),
    DeepSdfConfig(LENGTH, (24, 24, 24), latent_in=(1, 3), tanh=2),
    DeepSdfConfig(LENGTH, (16, 20, 16), latent_in=(2,), xyz_in_all=True, unit=1.7),
    DeepSdfConfig(LENGTH, (16, 16, 16), layer_norm=(0, 2), tanh=0, unit=0.3),
]


def make(config: DeepSdfConfig) -> DeepSdfDecoder:
    torch.manual_seed(0)
    decoder = DeepSdfDecoder(config).double()
    for name, parameter in decoder.named_parameters():
        nn.init.normal_(parameter, float("norm" in name), 0.4)
    return decoder.requires_grad_(False)


def concatenated(decoder: DeepSdfDecoder, points: torch.Tensor, code: torch.Tensor) -> torch.Tensor:
    """The same weights, joined column by column and applied to concatenated inputs."""
    config, state = decoder.config, decoder.state_dict()
    points = points * config.unit
    given = torch.cat([code.expand(len(points), -1), points], dim=1)
    h = torch.empty(len(points), 0, dtype=points.dtype)
    for i in range(len(config.dims) + 1):
        if i == 0 or i in config.latent_in:
            h = torch.cat([h, given], dim=1)
        elif config.xyz_in_all:
            h = torch.cat([h, points], dim=1)
        assert i == 0 or h.shape[1] == config.dims[i - 1]
        names = [f"{part}.{i}.weight" for part in ("hidden", "from_code", "from_point")]
        h = nn.functional.linear(
            h, torch.cat([state[name] for name in names if name in state], dim=1), state[f"bias.{i}"]
        )
        if i in config.layer_norm:
            h = nn.functional.layer_norm(h, h.shape[1:], state[f"norm.{i}.weight"], state[f"norm.{i}.bias"])
        if i < len(config.dims):
            h = h.relu()
    for _ in range(config.tanh):
        h = h.tanh()
    return h[:, 0] / config.unit


@pytest.mark.parametrize("config", CONFIGS)
def test_it_is_the_network_that_concatenates(config):
    decoder = make(config)
    points, code = torch.randn(30, 3).double(), torch.randn(1, LENGTH).double()
    value = decoder(points, code)
    assert value.std() > 1e-3
    torch.testing.assert_close(value, concatenated(decoder, points, code))


@pytest.mark.parametrize("config", CONFIGS)
def test_jacobian_is_that_of_differences(config):
    decoder = make(config)
    points, codes = torch.randn(12, 3).double(), torch.randn(2, LENGTH).double()
    owner = torch.arange(12) % 2
    jet = decoder.linearize(points, codes, owner)
    torch.testing.assert_close(jet.value, decoder(points, codes, owner))
    h = 1e-6
    for k in range(3):
        step = h * torch.eye(3).double()[k]
        numeric = (decoder(points + step, codes, owner) - decoder(points - step, codes, owner)) / (2 * h)
        torch.testing.assert_close(jet.d_point[:, k], numeric, atol=1e-6, rtol=1e-5)
    for k in range(LENGTH):
        step = h * torch.eye(LENGTH).double()[k]
        numeric = (decoder(points, codes + step, owner) - decoder(points, codes - step, owner)) / (2 * h)
        torch.testing.assert_close(jet.d_code[:, k], numeric, atol=1e-6, rtol=1e-5)
    assert jet.d_code.abs().max() > 1e-3


def test_unit_scales_points_and_distances_alike():
    small, large = (make(DeepSdfConfig(LENGTH, (16, 16), unit=unit)) for unit in (1.0, 2.0))
    points, code = torch.randn(9, 3).double(), torch.randn(1, LENGTH).double()
    torch.testing.assert_close(large(points, code), small(2 * points, code) / 2)
    torch.testing.assert_close(
        large.linearize(points, code).d_point, small.linearize(2 * points, code).d_point
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"dims": ()}, "do not fit"),
        ({"latent_in": (0,)}, "do not fit"),
        ({"latent_in": (3,)}, "do not fit"),
        ({"dims": (6, 6), "latent_in": (1,)}, "no room"),
        ({"unit": 0.0}, "positive"),
        ({"tanh": 3}, "tanh 3"),
    ],
)
def test_a_shape_that_cannot_be_is_refused(settings, message):
    with pytest.raises(FactorError, match=message):
        DeepSdfDecoder(DeepSdfConfig(**{"code_length": LENGTH, "dims": (16, 16), **settings}))
