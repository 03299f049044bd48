"""DeepSDF experiment folders become priors: the same network, in this library's units, and nothing is run."""

import json
import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn.utils import parametrizations

from objgraph.errors import PriorError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.training.codes.fit import code_statistics
from objgraph.training.convert import ConvertConfig, convert, convert_command
from objgraph.training.deepsdf_files import load_experiment

LENGTH, WIDTH = 3, 32
SPECS = {
    "Description": "spheres",
    "NetworkArch": "deep_sdf_decoder",
    "CodeLength": LENGTH,
    "CodeInitStdDev": 0.5,
    "NetworkSpecs": {
        "dims": [WIDTH, WIDTH, WIDTH],
        "dropout": [0, 1, 2],
        "dropout_prob": 0.2,
        "norm_layers": [0, 1, 2],
        "latent_in": [2],
        "xyz_in_all": False,
        "use_tanh": False,
        "latent_dropout": False,
        "weight_norm": True,
    },
}


def with_network(**changes) -> dict:
    return {**SPECS, "NetworkSpecs": {**SPECS["NetworkSpecs"], **changes}}


class Reference(nn.Module):
    """As the paper draws it: four layers, code and point concatenated again at the third."""

    def __init__(self, norm=None) -> None:
        super().__init__()
        norm, given = norm or (lambda layer: layer), LENGTH + 3
        self.lin0 = norm(nn.Linear(given, WIDTH))
        self.lin1 = norm(nn.Linear(WIDTH, WIDTH - given))
        self.lin2 = norm(nn.Linear(WIDTH, WIDTH))
        self.lin3 = nn.Linear(WIDTH, 1)

    def forward(self, points, codes):
        given = torch.cat([codes, points], dim=1)
        h = self.lin1(self.lin0(given).relu()).relu()
        h = self.lin2(torch.cat([h, given], dim=1)).relu()
        return self.lin3(h).tanh()[:, 0]


def radius(codes: torch.Tensor) -> torch.Tensor:
    return 0.6 + 0.1 * codes[:, 0]


@pytest.fixture(scope="module")
def trained() -> Reference:
    """Spheres whose radius the code's first entry says, in the source's units."""
    torch.manual_seed(0)
    network = Reference(nn.utils.weight_norm)
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    for step in range(400):
        points, codes = 2 * torch.rand(512, 3) - 1, torch.randn(512, LENGTH)
        truth = points.norm(dim=1) - radius(codes)
        loss = (network(points, codes) - truth.tanh()).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step == 300:
            optimizer.param_groups[0]["lr"] = 1e-3
    assert loss < 0.02
    return network


def write(folder: Path, network: nn.Module, codes=None, specs=SPECS, checkpoint: str = "latest") -> Path:
    (folder / "ModelParameters").mkdir(parents=True)
    (folder / "specs.json").write_text(json.dumps(specs))
    state = {f"module.{key}": value for key, value in network.state_dict().items()}
    torch.save({"epoch": 2000, "model_state_dict": state}, folder / "ModelParameters" / f"{checkpoint}.pth")
    if codes is not None:
        (folder / "LatentCodes").mkdir()
        torch.save({"epoch": 2000, "latent_codes": codes}, folder / "LatentCodes" / f"{checkpoint}.pth")
    return folder


@pytest.fixture
def codes() -> torch.Tensor:
    return 0.3 + 0.5 * torch.randn(30, LENGTH, generator=torch.Generator().manual_seed(1))


def settings(folder: Path, **more) -> ConvertConfig:
    return ConvertConfig(folder, "chair", folder / "chair.safetensors", **more)


@pytest.mark.parametrize("norm", [None, nn.utils.weight_norm, parametrizations.weight_norm])
def test_it_says_what_the_source_says(norm, tmp_path):
    torch.manual_seed(2)
    network = Reference(norm)
    if norm is nn.utils.weight_norm:
        with torch.no_grad():
            network.lin1.weight_g.mul_(1.7)  # so that a norm left out would show
    specs = SPECS if norm else with_network(weight_norm=False, norm_layers=[])
    decoder = load_experiment(write(tmp_path, network, specs=specs)).decoder
    points, code = torch.randn(50, 3), torch.randn(1, LENGTH)
    expected = network(points, code.expand(50, -1))
    assert expected.std() > 1e-3
    torch.testing.assert_close(decoder(points, code), expected.detach(), atol=1e-5, rtol=0)
    jet = decoder.double().linearize(points.double(), code.double())
    network, h = network.double(), 1e-6
    points, code = points.double(), code.double().expand(50, -1)
    for k, step in enumerate(h * torch.eye(3).double()):
        d_point = (network(points + step, code) - network(points - step, code)) / (2 * h)
        d_code = (network(points, code + step) - network(points, code - step)) / (2 * h)
        torch.testing.assert_close(jet.d_point[:, k], d_point.detach(), atol=1e-5, rtol=0)
        torch.testing.assert_close(jet.d_code[:, k], d_code.detach(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("embedding", [False, True])
def test_a_converted_prior_has_this_library_s_scale(trained, codes, tmp_path, embedding):
    kept = {"weight": codes} if embedding else codes[:, None]
    path = convert_command(settings(write(tmp_path, trained, kept)))
    prior = load_prior(path)
    assert prior.category == "chair"
    unit = prior.decoder.config.unit
    diagonals = 2 * np.sqrt(3) * radius(torch.as_tensor(prior.starts)).numpy()
    assert unit == pytest.approx(np.median(diagonals), rel=0.06)
    sizes = np.linalg.norm(prior.start_extents, axis=1)
    np.testing.assert_allclose(np.median(sizes), 1, rtol=0.03)
    points, code = 0.4 * torch.randn(40, 3), torch.randn(1, LENGTH)
    there = trained(unit * points, code.expand(40, -1)).detach() / unit
    torch.testing.assert_close(prior.decoder(points, code), there, atol=1e-5, rtol=0)
    np.testing.assert_allclose(prior.code_mean, codes.double().mean(0), atol=1e-6)
    np.testing.assert_allclose(prior.code_covariance, 9 * np.cov(codes.numpy().T), atol=2e-2)
    assert prior.prototypes is not None
    assert {tuple(c) for c in prior.prototypes.astype(np.float32)} <= {tuple(c) for c in codes.numpy()}
    assert prior.card["data"]["training_shapes"] == 30
    assert prior.card["converted"]["epoch"] == 2000
    assert (prior.size_mean, prior.residual_sigma) == (pytest.approx(1.17), 0.01)
    assert str(tmp_path) not in json.dumps(prior.card)
    assert sorted(item.name for item in tmp_path.glob("*.safetensors")) == ["chair.safetensors"]


def test_settings_are_kept(trained, tmp_path):
    folder = write(tmp_path, trained, checkpoint="1000")
    config = settings(
        folder, checkpoint="1000", canonical_scale=1.9, code_sigma=0.2, residual_sigma=0.02, size=2.0
    )
    prior = convert(replace(config, size_log_sigma=0.3))
    assert prior.decoder.config.unit == 1.9
    assert (prior.residual_sigma, prior.size_mean, prior.size_log_sigma) == (0.02, 2.0, pytest.approx(0.3))
    np.testing.assert_allclose(prior.code_covariance, 0.04 * np.eye(LENGTH))


def test_without_codes_they_are_what_training_began_with(trained, tmp_path):
    prior = convert(settings(write(tmp_path, trained)))
    np.testing.assert_allclose(prior.code_covariance, 0.25 / LENGTH * np.eye(LENGTH))
    np.testing.assert_array_equal(prior.code_mean, np.zeros(LENGTH))
    assert prior.prototypes is None
    assert extract_mesh(prior.decoder, prior.code_mean).extents == pytest.approx(
        np.full(3, 3**-0.5), rel=0.05
    )


class Trap:
    """A pickle of this makes a file where it is loaded."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize("length", [1, 2, 5])
def test_statistics_are_of_codes_of_any_length(length):
    codes = np.random.default_rng(0).normal(size=(50, length))
    mean, covariance = code_statistics(codes)
    np.testing.assert_allclose(mean, codes.mean(axis=0))
    assert covariance.shape == (length, length)
    ridge = 1e-3 * codes.var(axis=0, ddof=1).mean()
    np.testing.assert_allclose(np.diag(covariance), codes.var(axis=0, ddof=1) + ridge)


@pytest.mark.parametrize("place", ["ModelParameters", "LatentCodes"])
@pytest.mark.parametrize("legacy", [False, True])
def test_a_pickle_that_runs_code_is_refused_and_does_not_run(trained, codes, tmp_path, place, legacy):
    folder, mark = write(tmp_path, trained, codes), tmp_path / "ran"
    path, trap = folder / place / "latest.pth", Trap(mark)
    if legacy:
        path.write_bytes(pickle.dumps({"model_state_dict": trap, "latent_codes": trap}, protocol=2))
    else:
        torch.save({"model_state_dict": trap, "latent_codes": trap}, path)
    with pytest.raises(PriorError, match=rf"{place}/latest\.pth is refused: .* could run code"):
        convert_command(settings(folder))
    assert not mark.exists()
    assert not (folder / "chair.safetensors").exists()
    if legacy:
        pickle.loads(path.read_bytes())
    else:
        torch.load(path, weights_only=False)
    assert mark.exists()  # the trap was a real one


@pytest.mark.parametrize(
    ("place", "damage"),
    [("ModelParameters", "missing")]
    + [(p, d) for p in ("ModelParameters", "LatentCodes") for d in ("empty", "truncated", "text", "list")],
)
def test_a_bad_checkpoint_is_named(trained, codes, tmp_path, place, damage):
    folder = write(tmp_path, trained, codes)
    path = folder / place / "latest.pth"
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    elif damage == "list":
        torch.save([torch.zeros(3)], path)
    else:
        path.write_bytes({"empty": b"", "truncated": content[:-90], "text": b"no weights\n" * 9}[damage])
    with pytest.raises(PriorError, match=rf"{place}/latest\.pth"):
        convert_command(settings(folder))
    assert not (folder / "chair.safetensors").exists()


def without(key: str) -> dict:
    return {k: v for k, v in SPECS.items() if k != key}


@pytest.mark.parametrize(
    ("specs", "message"),
    [
        (without("CodeLength"), r"specs\.json: .*'CodeLength' is missing"),
        (without("NetworkSpecs"), r"specs\.json: .*'NetworkSpecs' is missing"),
        ({**SPECS, "NetworkSpecs": {}}, r"specs\.json: .*'dims' is missing"),
        ({**SPECS, "CodeLength": "64"}, r"specs\.json: CodeLength holds"),
        (with_network(dims=[0.5]), r"specs\.json: dims holds"),
        (with_network(latent_in=[True]), r"specs\.json: latent_in holds"),
        (with_network(latent_in=[9]), r"specs\.json describes no network"),
        (with_network(dims=[2, 2, 2]), r"specs\.json describes no network"),
        ({**SPECS, "NetworkArch": "siren"}, r"specs\.json: NetworkArch 'siren' is not known"),
        ({**SPECS, "CodeInitStdDev": 0}, r"specs\.json: CodeInitStdDev 0"),
        ({**SPECS, "CodeLength": 5}, r"latest\.pth: lin0 has a weight of .*code length 5"),
        (with_network(dims=[WIDTH] * 4), r"latest\.pth: lin3 has a weight"),
        (with_network(dims=[WIDTH] * 2, latent_in=[]), r"latest\.pth: lin1 has a weight"),
        (with_network(weight_norm=False), r"latest\.pth: bn0\.weight is missing"),
        ([], r"specs\.json is no JSON object"),
    ],
)
def test_specs_that_do_not_fit_are_named(trained, tmp_path, specs, message):
    with pytest.raises(PriorError, match=message):
        convert(settings(write(tmp_path, trained, specs=specs)))


def test_specs_that_cannot_be_read_are_named(trained, tmp_path):
    folder = write(tmp_path, trained)
    (folder / "specs.json").write_text("{")
    with pytest.raises(PriorError, match=r"specs\.json is no JSON"):
        convert(settings(folder))
    with pytest.raises(PriorError, match=r"absent/specs\.json cannot be read"):
        convert(settings(tmp_path / "absent"))
    (folder / "specs.json").write_text(json.dumps(SPECS))
    with pytest.raises(PriorError, match=r"7\.pth is missing; there are latest"):
        convert(settings(folder, checkpoint="7"))


def test_weights_that_are_none_are_named(trained, codes, tmp_path):
    broken = Reference(nn.utils.weight_norm)
    broken.load_state_dict(trained.state_dict())
    with torch.no_grad():
        broken.lin2.bias[3] = torch.nan
    with pytest.raises(PriorError, match=r"latest\.pth: the weights of bias\.2 are not finite"):
        convert(settings(write(tmp_path / "nan", broken)))
    codes[4, 1] = torch.inf
    with pytest.raises(PriorError, match=r"LatentCodes/latest\.pth: a code is not finite"):
        convert(settings(write(tmp_path / "inf", trained, codes)))
    with pytest.raises(PriorError, match=r"codes of shape \(30, 2\) are not of length 3"):
        convert(settings(write(tmp_path / "short", trained, codes[:, :2])))
    far = Reference(nn.utils.weight_norm)
    far.load_state_dict(trained.state_dict())
    with torch.no_grad():
        far.lin3.bias.add_(9)
    with pytest.raises(PriorError, match=r"latest\.pth: none of 1 typical codes has a surface"):
        convert(settings(write(tmp_path / "far", far)))


@pytest.mark.parametrize(
    "name", ["canonical_scale", "code_sigma", "residual_sigma", "size", "size_log_sigma"]
)
def test_settings_must_be_positive(tmp_path, name):
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(PriorError, match=name):
            convert(settings(tmp_path, **{name: value}))


def test_the_file_must_be_called_a_safetensors_file(tmp_path):
    with pytest.raises(PriorError, match=r"chair\.pth must end in \.safetensors"):
        convert_command(ConvertConfig(tmp_path, "chair", tmp_path / "chair.pth"))


@pytest.mark.parametrize(
    ("key", "other", "words"),
    [
        ("lin0.weight_g", torch.ones(5, 1), r"weight_g of \(5, 1\) does not fit its weight_v"),
        ("lin0.weight_v", torch.ones(5), r"does not fit its weight_v of \(5,\)"),
        ("lin3.weight", torch.ones(1, WIDTH).to_sparse(), r"lin3\.weight is no plain tensor"),
        ("lin3.weight", torch.ones(1, WIDTH, device="meta"), r"lin3\.weight is no plain tensor"),
        ("lin3.bias", torch.ones(1, dtype=torch.complex64), r"lin3\.bias is no plain tensor"),
    ],
)
def test_tensors_of_another_kind_or_shape_are_named(tmp_path, key, other, words):
    network = Reference(nn.utils.weight_norm)
    folder = write(tmp_path, network)
    path = folder / "ModelParameters" / "latest.pth"
    torch.save({"model_state_dict": {**network.state_dict(), key: other}}, path)
    with pytest.raises(PriorError, match=rf"latest\.pth: .*{words}"):
        load_experiment(folder)


def test_codes_that_were_saved_as_they_were_trained_are_read(codes, tmp_path):
    """The first releases put them together of leaves; so saved, they still ask for a gradient."""
    trained_on = torch.cat([code[None, None].clone().requires_grad_() for code in codes])
    found = load_experiment(write(tmp_path, Reference(nn.utils.weight_norm), trained_on)).codes
    np.testing.assert_array_equal(found, codes.double().numpy())
    torch.save({"latent_codes": codes.to_sparse()}, tmp_path / "LatentCodes" / "latest.pth")
    with pytest.raises(PriorError, match=r"LatentCodes/latest\.pth: latent_codes is no plain tensor"):
        load_experiment(tmp_path)
