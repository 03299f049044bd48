"""What a first guess is trained and measured on: which shapes, in which proportions, and what of them is kept."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.testing import assert_allclose

from factors.proportions import Proportions
from objgraph.errors import ConfigError, PriorError
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import save_prior
from objgraph.training.guess import command as module
from objgraph.training.guess.command import GuessCommand, guess_command, guess_quality, with_first_guess
from objgraph.training.guess.data import Draws, Shape, draw_all
from objgraph.training.guess.scenes import SceneConfig
from objgraph.training.guess.shapes import random_shapes
from objgraph.training.guess.train import TrainGuessConfig, measure_guess
from tests.toys import TOY_CODE, toy_prior

NETWORK = FirstGuessConfig(code_length=TOY_CODE, surface=16, free=8, heading_width=8, place_width=8, hidden=8)
CONFIG = TrainGuessConfig(NETWORK, scenes=2, steps=1, batch=4, half_precision=False)


def test_random_codes_have_the_proportions_that_the_prior_knows_them_to_have() -> None:
    slope = np.zeros((3, TOY_CODE))
    slope[2, 0] = 0.5
    known = Proportions(np.array([0.0, 0.1, 0.0]), slope, 1e-8 * np.eye(3))
    prior = replace(toy_prior(), box=np.array([0.5, 0.7, 0.5]), proportions=known)
    for shape in random_shapes(prior, 20, seed=0):
        assert prior.box is not None
        assert shape.extents is not None
        assert shape.code is not None
        expected = prior.box * np.exp(known.of(shape.code))
        assert_allclose(shape.extents, expected / np.linalg.norm(expected), rtol=1e-3)


def test_meshes_that_a_prior_has_seen_say_what_codes_tell_of_proportions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    box = np.array([0.5, 0.7, 0.5])
    rng = np.random.default_rng(0)
    seen = []
    for i in range(60):
        code = rng.normal(size=TOY_CODE)
        seen.append(Shape(str(i), box * np.exp([0.0, 0.0, 0.5 * code[0]]), code))
    monkeypatch.setattr(module, "known_shapes", lambda *_: seen)
    monkeypatch.setattr(module, "with_first_guess", lambda prior, *_: prior)
    path, out = tmp_path / "prior.safetensors", tmp_path / "out.safetensors"
    save_prior(replace(toy_prior(), box=box), path)
    folder = boxes(tmp_path / "meshes", "held.ply")
    guess_command(GuessCommand(str(path), out, (folder,), shapes=1, guess=CONFIG))
    found = load_prior(out).proportions
    assert found is not None
    assert_allclose(found.slope[2, 0], 0.5, atol=0.02)
    assert_allclose(found.slope[:2], 0.0, atol=1e-6)


def test_without_a_box_a_random_code_keeps_its_own_proportions(tmp_path: Path) -> None:
    """Every axis by the same factor but for what the proportions are varied by; not each shape made a cube."""
    prior = toy_prior()
    made = random_shapes(prior, 3, seed=0)
    draws = draw_all(made, prior, 1, SceneConfig(proportions=1e-6), 0, tmp_path)
    assert len(draws)
    for row, log_scale in zip(draws.shape, draws.log_scale, strict=True):
        edges = extract_mesh(prior.decoder, made[row].code, 56).extents
        assert edges.max() > 1.1 * edges.min()
        assert_allclose(log_scale, log_scale.mean(), atol=1e-3)


def test_a_code_without_a_surface_is_left_out(tmp_path: Path) -> None:
    prior = toy_prior()
    nothing = Shape("nothing", None, code=np.full(TOY_CODE, -40.0))
    draws = draw_all([nothing, *random_shapes(prior, 1, seed=0)], prior, 2, SceneConfig(), 0, tmp_path)
    assert set(draws.shape) == {1}


@pytest.mark.parametrize(
    "change",
    [
        {"card": {"stands": False}},
        {"size_mean": 2.0},
        {"size_log_sigma": 0.1},
        {"box": np.array([0.5, 0.7, 0.5])},
    ],
    ids=lambda change: next(iter(change)),
)
def test_scenes_of_objects_of_another_size_or_stand_are_drawn_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict
) -> None:
    caches = drawn_in(monkeypatch)
    shapes = [Shape("one", np.full(3, 1 / np.sqrt(3)), code=np.zeros(TOY_CODE))]
    one = toy_prior()
    for prior in (one, replace(one), replace(one, **change)):
        with pytest.raises(Stopped):
            with_first_guess(prior, shapes, [], CONFIG, tmp_path)
    assert caches[0] == caches[1]
    assert caches[0] != caches[2]


def test_scenes_of_a_held_out_mesh_that_was_turned_are_drawn_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    caches = drawn_in(monkeypatch)
    prior, shapes = toy_prior(), [Shape("one", np.full(3, 1 / np.sqrt(3)), code=np.zeros(TOY_CODE))]
    back = trimesh.creation.box(bounds=[[-0.5, 0, 0.4], [0.5, 0.8, 0.5]])
    for turn in (1, 1, -1):
        back.vertices = back.vertices * [turn, 1, turn]
        trimesh.Scene([trimesh.creation.box((1.0, 0.2, 1.0)), back]).export(tmp_path / "chair.ply")
        with pytest.raises(Stopped):
            with_first_guess(prior, shapes, [(tmp_path / "chair.ply", "chair.ply")], CONFIG, tmp_path)
    assert caches[0] == caches[1]
    assert caches[0] != caches[2]


class Stopped(Exception):
    """Where the training would begin."""


def drawn_in(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders of the scenes that would be drawn, none of which are."""
    caches: list[Path] = []

    def stop(shapes, prior, each, config, seed, cache, *_):
        caches.append(cache)
        raise Stopped

    monkeypatch.setattr(module, "draw_all", stop)
    return caches


def boxes(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True)
    for i, name in enumerate(names):
        trimesh.creation.box((1.0, 0.5 + 0.1 * i, 0.7)).export(folder / name)
    return folder


def chosen(monkeypatch: pytest.MonkeyPatch, prior: ShapePrior, folders: tuple[Path, ...]) -> tuple[set, set]:
    """The meshes that a first guess would learn from, and those that it would be measured on."""
    found: list[set[str]] = []

    def known(prior, seen, *_) -> list[Shape]:
        found.append({mesh.file for mesh in seen})
        return []

    def guessed(prior, shapes, unseen, *_) -> ShapePrior:
        found.append({name for _, name in unseen})
        return prior

    monkeypatch.setattr(module, "known_shapes", known)
    monkeypatch.setattr(module, "with_first_guess", guessed)
    path = folders[0].parent / "prior.safetensors"
    save_prior(prior, path)
    guess_command(GuessCommand(str(path), path, folders, shapes=1, guess=CONFIG))
    seen, unseen = found
    return seen, unseen


@pytest.mark.parametrize("indexed", [True, False])
def test_the_card_says_what_is_seen_and_what_is_held_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, indexed: bool
) -> None:
    """What it names as neither, as the meshes of which `--corpus.validation` makes no use, is neither."""
    folder = boxes(tmp_path / "meshes", "seen.ply", "held.ply", "neither.ply")
    if indexed:
        entry = {"category": "chair", "licence": "", "attribution": "", "source_repo": "s", "size_m": None}
        names = ("seen.ply", "held.ply", "neither.ply")
        listed = [{**entry, "file": name, "group": name} for name in names]
        (folder / "index.json").write_text(json.dumps({"meshes": listed}))
    card = {"data": {"collected": [{"files": ["seen.ply"]}]}, "heldout": {"collected": ["held.ply"]}}
    prior = replace(toy_prior(), card=card)
    assert chosen(monkeypatch, prior, (folder,)) == ({"seen.ply"}, {"held.ply"})
    # of a folder of which nothing is held out, what was not learnt from
    assert chosen(monkeypatch, replace(prior, card={"data": card["data"]}), (folder,)) == (
        {"seen.ply"},
        {"held.ply", "neither.ply"},
    )
    # a card of elsewhere names no files
    every = {"seen.ply", "held.ply", "neither.ply"}
    for data in ("none", {"collected": 3}, {"collected": [{"files": [[]]}]}):
        assert chosen(monkeypatch, replace(prior, card={"data": data}), (folder,)) == (set(), every)


def test_a_held_out_mesh_that_cannot_be_read_is_left_out_before_the_training(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_SCENES", 2)
    folder = boxes(tmp_path / "meshes", "good.ply")
    (folder / "bad.ply").write_text("nonsense")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export(folder / "flat.ply")
    unseen = [(folder / name, name) for name in ("bad.ply", "flat.ply", "good.ply")]
    shapes = random_shapes(toy_prior(), 1, seed=0)
    order: list[str] = []
    prior = with_first_guess(
        toy_prior(), shapes, unseen, CONFIG, tmp_path / "work", progress=lambda what, *_: order.append(what)
    )
    assert 1 <= prior.card["first_guess"]["heldout"]["1"]["objects"] <= 2
    for name in ("bad.ply", "flat.ply"):
        assert f"{name} is left out of what the first guess is measured on" in caplog.text
    assert order[0] == "drawing held-out scenes"
    alone = with_first_guess(toy_prior(), shapes, unseen[:2], CONFIG, tmp_path / "work")
    assert "heldout" not in alone.card["first_guess"]


def seen_twice() -> Draws:
    """Four objects, each in two views."""
    rng = np.random.default_rng(0)
    surface, normal, free = (rng.normal(size=(4, 3, n, 3)) for n in (20, 20, 10))
    T = np.tile(np.eye(4), (4, 1, 1))
    views, gaps = np.full(4, 2), np.zeros((4, 16))
    return Draws(
        surface, normal, free, rng.normal(size=(4, 3, 3)), views, np.zeros(4), T, np.zeros((4, 3)), gaps, np.arange(4)
    )  # fmt: skip


def test_numbers_of_views_in_which_nothing_is_seen_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    prior = replace(toy_prior(), guess=FirstGuess(NETWORK).requires_grad_(False))
    assert prior.guess is not None
    monkeypatch.setattr(module, "draw_all", lambda *_: seen_twice())
    assert set(guess_quality(prior, [], 0, tmp_path)) == {1, 2}
    with pytest.raises(PriorError, match="no object is seen in 3 views"):
        measure_guess(prior.guess, seen_twice(), 1.0, 3)


def test_a_guess_of_no_steps_is_refused(tmp_path: Path) -> None:
    command = GuessCommand("chair", tmp_path / "out.safetensors", guess=replace(CONFIG, steps=0))
    with pytest.raises(ConfigError, match=r"--guess\.steps is 0"):
        guess_command(command)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "words"),
    [("sofa", r"must end in \.safetensors"), ("file/sofa.safetensors", "cannot be written")],
)
def test_where_the_prior_could_not_be_written_is_told_before_any_work(
    tmp_path: Path, name: str, words: str
) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(PriorError, match=words):
        guess_command(GuessCommand("absent.safetensors", tmp_path / name))


def test_the_command_has_its_own_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    used, before = [], torch.get_num_threads()

    def guessed(prior, *_) -> ShapePrior:
        used.append(torch.get_num_threads())
        return prior

    monkeypatch.setattr(module, "with_first_guess", guessed)
    path = tmp_path / "prior.safetensors"
    save_prior(replace(toy_prior(), card={}), path)
    guess_command(GuessCommand(str(path), path, shapes=1, threads=before + 1, guess=CONFIG))
    assert used == [before + 1]
    assert torch.get_num_threads() == before
