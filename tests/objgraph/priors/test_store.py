"""Priors as files, and finding them by category."""

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from factors.code_mixture import CodeMixture
from factors.decoder import Decoder, DecoderConfig
from factors.errors import FactorError
from factors.proportions import Proportions
from factors.state import ObjectKeys, ObjectState
from objgraph.cli.priors import describe
from objgraph.errors import PriorError
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import digest, save_prior


@pytest.fixture
def prior() -> ShapePrior:
    torch.manual_seed(0)
    decoder = Decoder(DecoderConfig(code_length=3, width=8, depth=3, skip=1, octaves=1))
    return ShapePrior(
        "lamp", decoder, np.arange(3.0), np.diag([1.0, 2.0, 3.0]), 0.01, 0.5, 0.2, {"data": "none"}
    )


def rewrite(path: Path, change) -> None:
    """Change a saved prior's header or tensors and give it a fitting hash."""
    tensors = load_file(path)
    with safe_open(path, framework="pt") as file:
        header = json.loads(file.metadata()["json"])
    change(tensors, header)
    save_file(tensors, path, {"json": json.dumps({**header, "sha256": digest(tensors)})})


def test_a_first_guess_of_an_older_kind_is_left_out_and_it_is_said(
    prior: ShapePrior, tmp_path: Path, caplog
) -> None:
    path = tmp_path / "lamp.safetensors"
    network = FirstGuess(FirstGuessConfig(code_length=3, heading_width=8, place_width=8, hidden=8))
    save_prior(replace(prior, guess=network), path)
    loaded = load_prior(path)
    assert loaded.guess is not None
    assert loaded.guess.config == network.config
    rewrite(path, lambda tensors, header: header["guess"].pop("headings"))
    assert load_prior(path).guess is None
    assert "train-guess" in caplog.text


def test_round_trip(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    loaded = load_prior(path)
    assert (loaded.category, loaded.residual_sigma, loaded.size_mean, loaded.size_log_sigma) == (
        "lamp",
        0.01,
        0.5,
        0.2,
    )
    assert_array_equal(loaded.code_mean, prior.code_mean)
    assert_array_equal(loaded.code_covariance, prior.code_covariance)
    assert loaded.decoder.config == prior.decoder.config
    points, code = torch.rand(20, 3), torch.rand(1, 3)
    assert_array_equal(loaded.decoder(points, code).numpy(), prior.decoder(points, code).detach().numpy())
    assert not any(value.requires_grad for value in loaded.decoder.parameters())
    assert loaded.card["data"] == "none"
    assert loaded.card["frame"].startswith("y up")
    first = path.read_bytes()
    save_prior(loaded, path)
    assert path.read_bytes() == first
    assert [item.name for item in tmp_path.iterdir()] == ["lamp.safetensors"]


@pytest.mark.parametrize("damage", ["missing", "empty", "truncated", "text", "foreign", "flipped"])
def test_bad_file_is_named(prior: ShapePrior, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    elif damage == "foreign":
        save_file({"a": torch.zeros(3)}, path)
    else:
        flipped = content[:-5] + bytes([content[-5] ^ 1]) + content[-4:]
        path.write_bytes(
            {"empty": b"", "truncated": content[:-9], "text": b"no weights" * 50, "flipped": flipped}[damage]
        )
    with pytest.raises(PriorError, match=r"lamp\.safetensors"):
        load_prior(path)


def test_wrong_code_length(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    rewrite(path, lambda tensors, header: tensors.update(code_mean=torch.zeros(5)))
    with pytest.raises(PriorError, match="do not fit a decoder of 3-dimensional codes"):
        load_prior(path)
    with pytest.raises(FactorError, match="do not fit this decoder"):
        prior.decoder(torch.zeros(1, 3), torch.zeros(1, 5))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tensors, header: header.update(decoder=None), "in place of an object"),
        (lambda tensors, header: header.update(decoder=[["kind", "smooth"]]), "in place of an object"),
        (
            lambda tensors, header: header["decoder"].update(width=10**9),
            "width must be at least 1 and at most",
        ),
        (lambda tensors, header: header["decoder"].update(width=4000, depth=64), "more than it holds"),
        (lambda tensors, header: header["decoder"].update(width="8"), "width must be int"),
        (lambda tensors, header: header.update(residual_sigma=-0.01), "not positive"),
        (lambda tensors, header: header.update(size_mean=0), "not positive"),
        (lambda tensors, header: header.update(card=3), "no usable shape prior"),
        (lambda tensors, header: header.update(category="/"), "leads out of a folder"),
        (lambda tensors, header: header.update(category="../../elsewhere"), "leads out of a folder"),
        (lambda tensors, header: header.update(category=[]), "the category must be text"),
    ],
)
def test_a_header_that_cannot_be_is_named(prior: ShapePrior, tmp_path: Path, change, words: str) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    rewrite(path, change)
    with pytest.raises(PriorError, match=words) as caught:
        load_prior(path)
    assert str(path) in str(caught.value)


def test_tensors_that_are_no_floats_of_numpy_are_named(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    with safe_open(path, framework="pt") as file:
        header = file.metadata()
    save_file({**load_file(path), "code_mean": torch.zeros(3, dtype=torch.bfloat16)}, path, header)
    with pytest.raises(PriorError, match="bfloat16, a prior has floats alone"):
        load_prior(path)


@pytest.mark.parametrize(
    "card",
    [{"data": 3}, {"data": {"licences": 1}}, {"heldout": {"summary": {"count": "x"}}}, {"heldout": [1]}],
)
def test_a_card_that_cannot_be_listed_is_named(prior: ShapePrior, tmp_path: Path, card) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(replace(prior, card=card), path)
    with pytest.raises(PriorError, match="its card is damaged"):
        describe(path)


def test_what_was_measured_of_surfaces_is_kept(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(replace(prior, surface_misfit=2.5), path)
    assert load_prior(path).surface_misfit == 2.5
    rewrite(path, lambda tensors, header: header.pop("surface_misfit"))  # files of before it was kept
    assert load_prior(path).surface_misfit == 1.0


def test_the_kinds_of_shapes_are_kept_and_codes_are_drawn_of_them(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    rng = np.random.default_rng(0)
    kinds = CodeMixture(np.array([0.25, 0.75]), rng.normal(size=(2, 3)), rng.uniform(0.5, 2.0, (2, 3)))
    save_prior(replace(prior, kinds=kinds), path)
    loaded = load_prior(path)
    assert loaded.kinds is not None
    np.testing.assert_allclose(loaded.kinds.weight, kinds.weight, rtol=1e-6)
    np.testing.assert_allclose(loaded.kinds.mean, kinds.mean, rtol=1e-3)
    np.testing.assert_allclose(loaded.kinds.variance, kinds.variance, rtol=5e-3)
    np.testing.assert_array_equal(loaded.code_covariance, loaded.kinds.moments()[1])
    drawn = loaded.draw_codes(5, np.random.default_rng(1))
    np.testing.assert_array_equal(drawn, loaded.kinds.draw(5, np.random.default_rng(1)))
    values, keys = gtsam.Values(), ObjectKeys.numbered(0)
    values.insert(keys.code, kinds.mean[1])
    assert loaded.code_factor(keys).error(values) == pytest.approx(loaded.kinds.costs(kinds.mean[1:]).min())
    first = path.read_bytes()
    save_prior(loaded, path)
    assert path.read_bytes() == first
    rewrite(path, lambda tensors, header: tensors.update({"kinds.mean": torch.zeros(2, 5)}))
    with pytest.raises(PriorError, match=r"lamp\.safetensors is no usable shape prior: a mixture of"):
        load_prior(path)
    save_prior(replace(prior, kinds=kinds), path)
    longer = {f"kinds.{name}": torch.zeros(2, 5) for name in ("mean", "log_variance")}
    rewrite(path, lambda tensors, header: tensors.update(longer))
    with pytest.raises(PriorError, match="mixture is of codes of another length than its decoder's 3"):
        load_prior(path)
    save_prior(replace(prior, kinds=kinds), path)
    rewrite(path, lambda tensors, header: tensors.pop("kinds.log_variance"))
    with pytest.raises(PriorError, match="no usable shape prior"):
        load_prior(path)


def test_what_codes_say_of_proportions_is_kept_and_holds_the_scales(
    prior: ShapePrior, tmp_path: Path
) -> None:
    path = tmp_path / "lamp.safetensors"
    rng = np.random.default_rng(0)
    known = Proportions(rng.normal(size=3), rng.normal(size=(4, 3)).T[:, :3], 0.01 * np.eye(3))
    boxed = replace(prior, box=np.array([0.5, 0.6, 0.7]), proportions=known)
    save_prior(boxed, path)
    loaded = load_prior(path)
    assert loaded.proportions is not None
    for name, value in vars(known).items():
        assert_array_equal(getattr(loaded.proportions, name), value)
    first = path.read_bytes()
    save_prior(loaded, path)
    assert path.read_bytes() == first
    values, keys = gtsam.Values(), ObjectKeys.numbered(0)
    code = rng.normal(size=3)
    values.insert(keys.code, code)
    values.insert(keys.log_scale, np.log(loaded.size_mean) + known.of(code))
    assert loaded.scale_factor(keys).error(values) == pytest.approx(0.0, abs=1e-9)
    assert replace(loaded, proportions=None).scale_factor(keys).keys() == [keys.log_scale]
    for change in ({"slope": torch.zeros(3, 5)}, {"mean": torch.zeros(2)}, {"covariance": torch.zeros(3, 3)}):
        save_prior(boxed, path)
        named = {f"proportions.{name}": value for name, value in change.items()}
        rewrite(path, lambda tensors, header, named=named: tensors.update(named))
        with pytest.raises(PriorError, match=r"lamp\.safetensors.*proportions"):
            load_prior(path)
    save_prior(boxed, path)
    rewrite(path, lambda tensors, header: tensors.pop("box"))
    with pytest.raises(
        PriorError, match="proportions are of codes of another length, or of shapes without a box"
    ):
        load_prior(path)
    save_prior(boxed, path)
    rewrite(path, lambda tensors, header: tensors.pop("proportions.mean"))
    with pytest.raises(PriorError, match="no usable shape prior"):
        load_prior(path)


def test_a_loaded_prior_stays_when_its_file_is_written_over(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    prior = replace(prior, prototypes=np.ones((2, 3)), box=np.array([0.5, 0.6, 0.7]))
    save_prior(prior, path)
    loaded = load_prior(path)
    with path.open("r+b") as file:
        file.write(b"\xff" * path.stat().st_size)
    assert loaded.box is not None
    assert loaded.prototypes is not None
    np.testing.assert_array_equal(loaded.box, [0.5, 0.6, 0.7])
    np.testing.assert_array_equal(loaded.prototypes, np.ones((2, 3)))
    np.testing.assert_array_equal(loaded.code_mean, prior.code_mean)


def test_not_finite_weights(prior: ShapePrior, tmp_path: Path) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    rewrite(path, lambda tensors, header: header.update(residual_sigma=float("nan")))
    with pytest.raises(PriorError, match="not finite"):
        load_prior(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size_log_sigma": 0.0}, "not positive"),
        ({"anisotropy_sigma": 0.0}, "not positive"),
        ({"residual_sigma": float("nan")}, "not finite"),
        ({"code_mean": np.zeros(5)}, "do not fit a decoder of 3-dimensional codes"),
        ({"code_mean": np.full(3, np.inf)}, "not finite"),
        ({"code_covariance": -np.eye(3)}, "the codes' covariance is not positive definite"),
        ({"box": np.array([0.5, 0.0, 0.7])}, "not three positive edges"),
        ({"kinds": CodeMixture(np.ones(1), np.zeros((1, 5)), np.ones((1, 5)))}, "mixture is of codes of another"),
        ({"card": {"data": {1, 2}}}, "no usable shape prior"),
    ],
)  # fmt: skip
def test_what_could_not_be_loaded_is_not_saved(prior: ShapePrior, tmp_path: Path, change, words: str) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    before = path.read_bytes()
    with pytest.raises(PriorError, match=words) as caught:
        save_prior(replace(prior, **change), path)
    assert str(path) in str(caught.value)
    assert path.read_bytes() == before


def test_saving_and_loading_leave_the_global_generator_alone(prior: ShapePrior, tmp_path: Path) -> None:
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    save_prior(prior, tmp_path / "lamp.safetensors")
    load_prior(tmp_path / "lamp.safetensors")
    assert_array_equal(torch.rand(2).numpy(), expected.numpy())


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors, header: header.update(format="objgraph-prior-0"),
        lambda tensors, header: header.update(decoder={"width": 8}),
        lambda tensors, header: header.update(decoder={"colour": 8}),
        lambda tensors, header: header.update(decoder={"depth": 2, "skip": 4}),
        lambda tensors, header: header.pop("size_mean"),
        lambda tensors, header: tensors.pop("decoder.output.bias"),
        lambda tensors, header: tensors.pop("code_mean"),
        lambda tensors, header: header.update(surface_misfit=0.0),
        lambda tensors, header: header.update(surface_misfit=float("inf")),
        lambda tensors, header: header.update(surface_misfit="much"),
    ],
)
def test_header_that_does_not_fit_the_weights(prior: ShapePrior, tmp_path: Path, change) -> None:
    path = tmp_path / "lamp.safetensors"
    save_prior(prior, path)
    load_prior(path)
    rewrite(path, change)
    with pytest.raises(PriorError, match=r"lamp\.safetensors"):
        load_prior(path)


def test_what_need_not_stand_has_no_feet() -> None:
    chair = load_prior("chair")
    assert chair.box is not None
    assert chair.feet == pytest.approx(chair.box[1] / 2)
    assert replace(chair, box=None).feet is None
    lamp = replace(chair, card=chair.card | {"stands": False})
    assert lamp.feet is None
    keys, lifted = ObjectKeys.numbered(0), gtsam.Values()
    place = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.array([0.0, 0.0, 2.0]))
    ObjectState(place, np.zeros(3), chair.code_mean).insert(lifted, keys)
    up, config = np.array([0.0, 0.0, 1.0]), GraphConfig()
    costs = [ObjectBuilder(config, up, 0.0).standing(prior, keys)[0].loss(lifted) for prior in (chair, lamp)]
    assert costs[0] > 10
    assert costs[1] == pytest.approx(0.0, abs=1e-6)
