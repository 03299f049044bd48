import pytest
import torch

from factors.affine import Activation, activated
from factors.decoder import Decoder, DecoderConfig
from factors.errors import FactorError
from tests.factors.conftest import CODE_LENGTH, make_decoder


@pytest.mark.parametrize(
    "settings",
    [{}, {"skip": 0}, {"octaves": 2}, {"activation": "softplus"}, {"activation": "relu"}, {"mapping": 7}],
)
def test_jacobian_is_autograds_own(settings):
    decoder = make_decoder(**settings)
    points, codes = torch.randn(7, 3).double(), torch.randn(1, CODE_LENGTH).double()
    jet = decoder.linearize(points, codes)

    def value(p, z):
        return decoder(p[None], z[None])[0]

    for i in range(7):
        d_point, d_code = torch.autograd.functional.jacobian(value, (points[i], codes[0]))
        torch.testing.assert_close(jet.d_point[i], d_point)
        torch.testing.assert_close(jet.d_code[i], d_code)
    torch.testing.assert_close(jet.value, decoder(points, codes).detach())
    torch.testing.assert_close(decoder.gradient(points, codes[0]), jet.d_point)


@pytest.mark.parametrize(
    "settings", [{}, {"skip": 0}, {"octaves": 2}, {"depth": 1, "skip": 0}, {"mapping": 9}]
)
@pytest.mark.parametrize("owner", [None, torch.tensor([0, 1, 1, 0, 1])])
def test_derivatives_by_hand_are_autograds(settings, owner):
    torch.manual_seed(3)
    decoder = Decoder(
        DecoderConfig(**{"code_length": 6, "width": 16, "activation": "relu"} | settings)
    ).double()
    points, codes = torch.randn(5, 3).double(), torch.randn(1 if owner is None else 2, 6).double()
    jet = decoder.linearize(points, codes, owner)
    points.requires_grad_()
    rows = codes.expand(5, -1).clone() if owner is None else codes[owner]
    value = decoder(points, rows.requires_grad_(), torch.arange(5))
    d_point, d_code = torch.autograd.grad(value.sum(), [points, rows])
    for found, true in zip(jet, (value.detach(), d_point, d_code), strict=True):
        torch.testing.assert_close(found, true)


@pytest.mark.parametrize("mapping", [0, 8])
def test_blocks_are_points_that_the_shapes_own(mapping):
    decoder = make_decoder(mapping=mapping)
    points, codes = torch.randn(3, 4, 3).double(), torch.randn(3, CODE_LENGTH).double()
    owner = torch.arange(3).repeat_interleave(4)
    torch.testing.assert_close(
        decoder.in_blocks(points, codes).flatten(), decoder(points.flatten(0, 1), codes, owner)
    )


def test_owner_tells_shapes_apart(decoder):
    points, codes = torch.randn(6, 3).double(), torch.randn(2, CODE_LENGTH).double()
    owner = torch.tensor([0, 1, 1, 0, 0, 1])
    together = decoder.linearize(points, codes, owner)
    for shape in (0, 1):
        alone = decoder.linearize(points[owner == shape], codes[shape : shape + 1])
        for a, b in zip(together, alone, strict=True):
            torch.testing.assert_close(a[owner == shape], b)


@pytest.mark.parametrize("settings", [{"activation": "relu"}, {"activation": "relu", "mapping": 9}])
@pytest.mark.parametrize("counts", [(700, 90, 3), (70, 3000, 1, 1, 1, 1), (1, 1)])
@pytest.mark.parametrize("mixed", [False, True])
def test_a_shape_is_to_the_bit_what_it_is_alone(settings, counts, mixed):
    """Solvers meet other minima by rounding: what is decoded beside an object must not tell."""
    torch.manual_seed(1)
    decoder = Decoder(DecoderConfig(**{"code_length": 6, "width": 64} | settings))
    codes, points = torch.randn(len(counts), 6), torch.randn(sum(counts), 3)
    owner = torch.repeat_interleave(torch.arange(len(counts)), torch.tensor(counts))
    owner = owner[torch.randperm(len(owner))] if mixed else owner
    with torch.no_grad():
        together = [decoder(points, codes, owner), *decoder.linearize(points, codes, owner)]
        for i in range(len(counts)):
            part = points[owner == i]
            alone = [decoder(part, codes[i : i + 1]), *decoder.linearize(part, codes[i : i + 1])]
            for a, b in zip(together, alone, strict=True):
                assert torch.equal(a[owner == i], b)


@pytest.mark.parametrize(
    "settings",
    [{}, {"skip": 0}, {"octaves": 2}, {"activation": "silu"}, {"activation": "softplus"}, {"mapping": 9}],
)
def test_points_that_stand_together_are_decoded_as_if_alone(settings):
    """In single precision, where a code is a bias more; and in any order."""
    torch.manual_seed(3)
    decoder = Decoder(DecoderConfig(**{"code_length": 6, "width": 16, "activation": "relu"} | settings))
    points, codes = torch.randn(2500, 3), torch.randn(3, 6)
    owner = torch.tensor([1, 0, 2]).repeat_interleave(torch.tensor([70, 2330, 100]))
    with torch.no_grad():
        value = decoder(points, codes, owner)
    jet = decoder.linearize(points, codes, owner)
    for shape in range(3):
        own = owner == shape
        one = codes[shape : shape + 1]
        with torch.no_grad():
            torch.testing.assert_close(value[own], decoder(points[own], one))
        for found, alone in zip(jet, decoder.linearize(points[own], one), strict=True):
            torch.testing.assert_close(found[own], alone, rtol=1e-4, atol=1e-5)
    mixed = torch.randperm(len(points))
    for found, other in zip(jet, decoder.linearize(points[mixed], codes, owner[mixed]), strict=True):
        torch.testing.assert_close(found[mixed], other, rtol=1e-4, atol=1e-5)


def test_wrong_code_length_is_named(decoder):
    with pytest.raises(FactorError, match=rf"takes \(b, {CODE_LENGTH}\)"):
        decoder(torch.zeros(2, 3).double(), torch.zeros(1, CODE_LENGTH + 1).double())


def test_many_codes_need_an_owner(decoder):
    with pytest.raises(FactorError, match="owner"):
        decoder(torch.zeros(2, 3).double(), torch.zeros(2, CODE_LENGTH).double())


def test_skip_must_be_a_layer():
    with pytest.raises(FactorError, match="skip"):
        Decoder(DecoderConfig(depth=3, skip=3))


@pytest.mark.parametrize("mapping", [0, 8])
def test_products_have_few_sizes(mapping, monkeypatch):
    decoder = Decoder(DecoderConfig(code_length=6, width=16, activation="relu", mapping=mapping))
    sizes = set()

    def noted(x, weight, bias=None, activation: Activation = "none"):
        sizes.add(len(x))
        return activated(torch.nn.functional.linear(x, weight, bias), activation)

    for module in ("factors.affine", "factors.decoder", "factors.sdf_decoder"):
        monkeypatch.setattr(f"{module}.affine", noted)
    codes = torch.randn(3, 6)
    for n in range(0, 7000, 37):
        points, owner = torch.randn(n, 3), torch.randint(0, 3, (n,))
        with torch.no_grad():
            assert len(decoder(points, codes, owner)) == n
        assert all(len(each) == n for each in decoder.linearize(points, codes, owner))
    assert len(sizes) <= 33
    assert max(sizes) == 2048


def test_a_point_alone_has_the_gradient_of_its_code():
    decoder, points = make_decoder(), torch.randn(1, 3).double()
    codes = torch.randn(1, CODE_LENGTH).double().requires_grad_()
    (found,) = torch.autograd.grad(decoder(points, codes).sum(), codes)
    torch.testing.assert_close(found, decoder.linearize(points, codes.detach()).d_code)
