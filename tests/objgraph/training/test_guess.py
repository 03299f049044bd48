"""The first guess: its scenes, how it is trained, and what it proposes for an object that is seen."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import gtsam
import numpy as np
import pytest
import torch
import trimesh
from numpy.testing import assert_allclose

from factors.decoder import Decoder, DecoderConfig
from objgraph.errors import InitialisationError, PriorError
from objgraph.geometry.frames import upright_axes
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import InitialisationConfig, first_states
from objgraph.graph.proposals import proposals
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.priors.first_guess import FirstGuess, FirstGuessConfig
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import save_prior
from objgraph.training.guess.command import GuessCommand, guess_command, with_first_guess
from objgraph.training.guess.data import (
    Draws,
    Look,
    Shape,
    batch,
    draw_all,
    first_views,
    varied,
)
from objgraph.training.guess.scenes import UP, SceneConfig, draw_seen
from objgraph.training.guess.shapes import known_shapes, random_shapes
from objgraph.training.guess.train import TrainGuessConfig, measure_guess, train_guess
from objgraph.training.meshes.index import read_index
from tests.toys import TOY_CODE, toy_frame, toy_mesh, toy_prior, toy_state

NETWORK = FirstGuessConfig(
    code_length=TOY_CODE, surface=64, free=32, heading_width=32, place_width=32, hidden=32
)
CONFIG = TrainGuessConfig(NETWORK, steps=60, batch=16, half_precision=False, checkpoint_every=20)
CODES = np.random.default_rng(0).normal(0, 0.5, (6, TOY_CODE))


def shapes() -> list[Shape]:
    found = []
    for i, code in enumerate(CODES):
        mesh = toy_mesh(code)
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        mesh.apply_scale(1 / mesh.scale)
        found.append(Shape(str(i), np.asarray(mesh.extents), mesh=mesh))
    return found


@pytest.fixture(scope="module")
def draws(tmp_path_factory: pytest.TempPathFactory) -> Draws:
    cache = tmp_path_factory.mktemp("draws")
    drawn = draw_all(shapes(), toy_prior(), 3, SceneConfig(), 0, cache)
    again = draw_all(shapes(), toy_prior(), 3, SceneConfig(), 0, cache)
    assert_allclose(again.surface, drawn.surface)
    return drawn


def box(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(np.array(size) / np.linalg.norm(size))


def test_what_is_seen_lies_on_the_object_or_outside_of_it() -> None:
    shape = shapes()[0]
    assert shape.mesh is not None
    assert shape.extents is not None
    seen = None
    rng = np.random.default_rng(3)
    while seen is None:
        seen = draw_seen(shape.mesh, shape.extents, toy_prior(), SceneConfig(), rng)
    assert len(seen.views) >= 2
    p_world = np.concatenate([view.points_world for view in seen.views])
    T = np.linalg.inv(seen.T_world_object)
    p_object = (p_world @ T[:3, :3].T + T[:3, 3]) / seen.scale
    near = np.abs(p_object) < 0.5 * shape.extents + 0.1
    # masks are wrong and cameras are off, so not all of them
    assert near.all(axis=1).mean() > 0.7
    assert seen.T_world_object[2, 3] == pytest.approx(0.5 * shape.extents[1] * seen.scale[1])
    assert seen.floor is not None
    assert abs(seen.floor) < 0.1


@pytest.mark.parametrize("look", [first_views(1), varied(np.random.default_rng(1))])
def test_places_in_a_batch_are_those_of_the_objects(draws: Draws, look: Callable[[Draws, int], Look]) -> None:
    """Of all headings the object's own says where it is; those a quarter turn off, where its look-alikes are. In a mirror as well."""
    made = batch(draws, range(len(draws)), 1.1, NETWORK, np.random.default_rng(0), look)
    assert_allclose(made.weight.sum(dim=1), 1.0, atol=1e-5)
    each, best = torch.arange(len(draws)), made.weight.argmax(dim=1)
    assert torch.equal(best, made.off.abs().argmin(dim=1))  # a chair looks like itself
    assert_allclose(made.place[each, best, 0], made.off[each, best], atol=1e-6)
    assert made.place[:, :, 0].abs().max() <= np.pi / 16 + 1e-6
    assert_allclose(made.place[each, best, 4:], draws.log_scale - np.log(1.1), atol=1e-5)
    for other in (best + 4) % 16, (best - 4) % 16:
        assert_allclose(made.place[each, other][:, [6, 5, 4]], made.place[each, best][:, 4:], atol=1e-5)


def test_what_is_seen_in_a_mirror_is_of_the_mirrored_object() -> None:
    """Seen points lie about the object where the mirrored ones lie about the mirrored object."""
    rng = np.random.default_rng(0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = upright_axes(UP, 0.4), (1.0, 2.0, 0.5)
    p_object = rng.normal(size=(1, 1, 30, 3))
    p_world = p_object @ T[:3, :3].T + T[:3, 3]
    gaps = np.arange(16.0)[None]
    n_world = p_object @ T[:3, :3].T
    one = Draws(
        p_world, n_world, p_world, p_world[:, :, 0], np.array([1]), np.zeros(1), T[None], np.zeros((1, 3)), gaps,
        np.zeros(1),
    )  # fmt: skip
    found = set()
    for seed in range(8):
        look = varied(np.random.default_rng(seed))(one, 0)
        (view,), T_seen, gaps_seen = look.seen, look.T_world_object, look.gaps
        p_seen = (view.surface - T_seen[:3, 3]) @ T_seen[:3, :3]
        mirrored = not np.allclose(p_seen, p_object[0, 0])
        assert_allclose(p_seen, p_object[0, 0] * [-1 if mirrored else 1, 1, 1], atol=1e-9)
        assert_allclose(view.normals @ T_seen[:3, :3], p_seen, atol=1e-9)
        assert np.linalg.det(T_seen[:3, :3]) == pytest.approx(1.0)
        assert gaps_seen[1] == (15 if mirrored else 1)
        assert gaps_seen[0] == 0
        found.add(mirrored)
    assert found == {True, False}


def test_killed_training_goes_on_with_the_same_result(draws: Draws, tmp_path: Path) -> None:
    before = torch.random.get_rng_state()
    whole = train_guess(draws, CODES, 1.1, CONFIG)
    assert torch.equal(torch.random.get_rng_state(), before)
    train_guess(draws, CODES, 1.1, CONFIG, tmp_path / "checkpoint", stop_after=30)
    resumed = train_guess(draws, CODES, 1.1, CONFIG, tmp_path / "checkpoint")
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(PriorError, match="another training"):
        train_guess(draws, CODES, 1.1, replace(CONFIG, steps=61), tmp_path / "checkpoint")


def test_training_finds_headings(draws: Draws) -> None:
    """On what it is trained on it says more than chance, which is about -log 2/16, and than no training does."""
    trained = train_guess(draws, CODES, 1.1, replace(CONFIG, steps=400, learning_rate=3e-3))
    after = measure_guess(trained, draws, 1.1, views=2)
    torch.manual_seed(0)
    before = measure_guess(FirstGuess(NETWORK), draws, 1.1, views=2)
    assert before.heading_nll > 1.5
    assert after.heading_nll < 0.7
    assert after.centre_m < 0.8 * before.centre_m


@cache
def views(turned: float = 0.0) -> tuple[ObjectView, ...]:
    """A toy chair from two sides, in a world that is turned about its z."""
    frames = [toy_frame([toy_state()], azimuth, str(k), seed=k) for k, azimuth in enumerate((4.0, 4.8))]
    seen = [observe(frame, 1, SamplingConfig(), seed=0) for frame in frames]
    turn = gtsam.Pose3(gtsam.Rot3.Rz(turned), np.zeros(3))
    return tuple(replace(view, T_world_camera=turn.compose(view.T_world_camera)) for view in seen)


def prior_with_guess() -> ShapePrior:
    torch.manual_seed(1)
    return replace(toy_prior(), guess=FirstGuess(NETWORK).requires_grad_(False))


def test_proposals_are_likeliest_first_and_turn_with_the_world() -> None:
    first = proposals(prior_with_guess(), views(), UP, 0.0)
    turned = proposals(prior_with_guess(), views(0.3), UP, 0.0)
    assert sum(each.probability for each in first) == pytest.approx(1.0)
    assert [p.probability for p in first] == sorted((p.probability for p in first), reverse=True)
    turn = gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.zeros(3))
    for a, b in zip(first, turned, strict=True):
        assert a.probability == pytest.approx(b.probability, abs=1e-3)
        assert_allclose(a.state.log_scale, b.state.log_scale, atol=1e-3)
        T = turn.compose(a.state.T_world_object)
        assert_allclose(T.translation(), b.state.T_world_object.translation(), atol=1e-3)
        assert_allclose(T.rotation().matrix(), b.state.T_world_object.rotation().matrix(), atol=1e-3)
        # upright: the object's y is up
        assert_allclose(b.state.T_world_object.rotation().matrix()[:, 1], UP, atol=1e-6)


def test_a_prior_gets_a_guess_and_its_card_says_what_it_is_worth(tmp_path: Path) -> None:
    """From codes and held-out meshes; what is done is not done again, and another decoder's is."""
    for i, shape in enumerate(shapes()[:2]):
        assert shape.mesh is not None
        shape.mesh.export(tmp_path / f"{i}.ply")
    unseen = [(tmp_path / f"{i}.ply", str(i)) for i in range(2)]
    coded = [replace(shape, mesh=None, code=code) for shape, code in zip(shapes(), CODES, strict=True)]
    config = replace(CONFIG, scenes=12, steps=20)
    prior = with_first_guess(toy_prior(), coded, unseen, config, tmp_path / "work")
    assert prior.guess is not None
    said = prior.card["first_guess"]
    assert said["shapes"] == 6
    assert said["scenes"] == 12
    assert set(said["heldout"]) == {"1", "2", "3"}
    assert 0 <= said["heldout"]["1"]["heading_right"] <= 1
    kept = sorted((tmp_path / "work").rglob("*.safetensors"))
    before = [path.stat().st_mtime_ns for path in kept]
    again = with_first_guess(toy_prior(), coded, unseen, config, tmp_path / "work")
    assert [path.stat().st_mtime_ns for path in kept] == before
    assert again.guess is not None
    # of another length it begins anew
    other = with_first_guess(toy_prior(), coded, [], replace(config, steps=10), tmp_path / "work")
    assert other.card["first_guess"]["settings"]["steps"] == 10
    # other meshes are drawn anew
    fewer = with_first_guess(toy_prior(), coded, unseen[1:], config, tmp_path / "work")
    assert fewer.card["first_guess"]["heldout"]["1"]["objects"] < said["heldout"]["1"]["objects"]
    for a, b in zip(prior.guess.parameters(), again.guess.parameters(), strict=True):
        assert torch.equal(a, b)


def octahedra() -> Decoder:
    """|x| + |y| + |z| = 0.3, whatever the code, by its weights: what of a toy decoder a file keeps is none of its shape."""
    decoder = Decoder(DecoderConfig(code_length=TOY_CODE, width=6, depth=1, skip=0, activation="relu"))
    state = {name: torch.zeros_like(value) for name, value in decoder.state_dict().items()}
    state["from_point.0.weight"] = torch.cat([torch.eye(3), -torch.eye(3)])
    state["output.weight"], state["output.bias"] = torch.full((1, 6), 3**-0.5), torch.tensor([-0.3 * 3**-0.5])
    decoder.load_state_dict(state)
    return decoder


def test_a_prior_whose_shapes_are_not_at_hand_gets_a_guess_from_random_codes(tmp_path: Path) -> None:
    save_prior(replace(toy_prior(), decoder=octahedra()), tmp_path / "toy.safetensors")
    boxed = replace(toy_prior(), box=np.array([0.5, 0.7, 0.5]), anisotropy_sigma=0.1)
    edges = np.array([shape.extents for shape in random_shapes(boxed, 5, seed=0)])
    assert_allclose(np.linalg.norm(edges, axis=1), 1.0)
    assert len(np.unique(edges[:, 0])) == 5
    command = GuessCommand(
        str(tmp_path / "toy.safetensors"), tmp_path / "out.safetensors", work=tmp_path / "work",
        guess=replace(CONFIG, scenes=8, steps=5),
    )  # fmt: skip
    written = load_prior(guess_command(command))
    assert written.guess is not None
    assert written.guess.config.code_length == TOY_CODE
    assert written.card["first_guess"]["shapes"] == 8
    assert "heldout" not in written.card["first_guess"]


def test_a_guess_learns_from_the_meshes_that_its_prior_has_seen(meshes: Path, tmp_path: Path) -> None:
    """Not from those held out, of which the card tells; a broken one is left out, and codes are looked for once."""
    files = [f"t{i}.ply" for i in (0, 1, 3, 4)]
    card = {"heldout": {"collected": ["t2.ply"]}, "data": {"collected": [{"files": files}]}}
    prior = replace(toy_prior(), category="table", card=card)
    seen = [entry for entry in read_index(meshes, "table") if entry.file != "t2.ply"]
    known = known_shapes(prior, seen, tmp_path / "work")
    assert [shape.name for shape in known] == ["t0.ply", "t1.ply", "t3.ply"]
    for shape, width in zip(known, (0.6, 0.65, 0.75), strict=True):
        edges = np.array([width, 0.3, 0.5])
        assert shape.extents is not None
        assert_allclose(shape.extents, edges / np.linalg.norm(edges), atol=1e-3)
        assert shape.code is not None
        assert shape.code.shape == (TOY_CODE,)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "work").rglob("*.safetensors")}
    known_shapes(prior, seen, tmp_path / "work")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "work").rglob("*.safetensors")} == kept
    save_prior(prior, tmp_path / "table.safetensors")
    command = GuessCommand(
        str(tmp_path / "table.safetensors"), tmp_path / "out.safetensors", (meshes,), shapes=4, work=tmp_path / "work",
        guess=replace(CONFIG, scenes=10, steps=5),
    )  # fmt: skip
    card = load_prior(guess_command(command)).card["first_guess"]
    # three meshes and four codes; the mesh held out in six scenes, of which some do not show it
    assert card["shapes"] == 7
    assert 1 <= card["heldout"]["1"]["objects"] <= 6


def test_random_codes_take_the_proportions_of_the_known_shape_that_is_nearest() -> None:
    wide, high = np.array([0.9, 0.1, 0.42]), np.array([0.1, 0.9, 0.42])
    flat = Shape("flat", wide, code=np.full(TOY_CODE, 5.0))
    tall = Shape("tall", high, code=np.full(TOY_CODE, -5.0))
    drawn, found = random_shapes(toy_prior(), 40, seed=0, known=[flat, tall]), set()
    for shape in drawn:
        assert shape.code is not None
        assert shape.extents is not None
        assert_allclose(shape.extents, wide if shape.code.sum() > 0 else high)
        found.add(shape.extents[1])
    assert found == {0.1, 0.9}


def test_what_need_not_stand_is_seen_above_the_floor() -> None:
    shape, rng = shapes()[0], np.random.default_rng(1)
    assert shape.mesh is not None
    assert shape.extents is not None
    hung = replace(toy_prior(), card={"stands": False})
    seen = [draw_seen(shape.mesh, shape.extents, hung, SceneConfig(), rng) for _ in range(4)]
    raised = [
        each.T_world_object[2, 3] - 0.5 * shape.extents[1] * each.scale[1]
        for each in seen
        if each is not None
    ]
    assert max(raised) > 0.1
    assert all(each.floor is None for each in seen if each is not None)


def test_first_states_are_the_likely_proposals() -> None:
    prior = prior_with_guess()
    every = proposals(prior, views(), UP, 0.0)
    limit = 0.5 * (every[1].probability + every[2].probability)
    found = first_states(
        prior, views(), ObjectBuilder(up_world=UP, floor=0.0), InitialisationConfig(least_chance=limit)
    )
    assert found.chances == pytest.approx([each.probability for each in every[:2]])
    assert not found.tried
    for state, proposal in zip(found.states, every, strict=False):
        assert_allclose(state.code, proposal.state.code)
        assert state.T_world_object.equals(proposal.state.T_world_object, 1e-9)
    # however unlikely, one is left
    alone = first_states(
        prior, views(), ObjectBuilder(up_world=UP, floor=0.0), InitialisationConfig(least_chance=1.0)
    )
    assert len(alone.states) == 1


def test_too_few_points_are_no_object() -> None:
    with pytest.raises(InitialisationError, match="add views"):
        proposals(prior_with_guess(), (), UP, None)
