"""Training: it learns, resumes bit for bit after a kill, and stops cleanly where it must."""

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from torch.distributions import Bernoulli

from factors.decoder import Decoder, DecoderConfig
from objgraph.errors import PriorError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.codes.fit import FitError, fit_error
from objgraph.training.codes.proportions import FEWEST
from objgraph.training.decoder.box_frame import BoxFrame
from objgraph.training.decoder.losses import sign_errors
from objgraph.training.decoder.train import (
    OptimiserConfig,
    TrainConfig,
    Trained,
    checkpoint_path,
    schedule,
    train,
)
from objgraph.training.export import _proportions, attribution, make_prior, train_command
from objgraph.training.guess.train import TrainGuessConfig
from objgraph.training.meshes.corpus import Corpus, CorpusConfig
from objgraph.training.meshes.index import CadMesh
from objgraph.training.meshes.samples import SampleConfig, SdfSamples
from objgraph.training.size import LEAST_SIGMA


def ball(radius: float, seed: int, count: int = 1500) -> SdfSamples:
    """Samples of a ball about the origin."""
    rng = np.random.default_rng(seed)
    outward = rng.normal(size=(count, 3))
    near = (
        (radius + 0.005 * rng.normal(size=(count, 1)))
        * outward
        / np.linalg.norm(outward, axis=1, keepdims=True)
    )
    points = np.concatenate([near, rng.uniform(-0.6, 0.6, (count, 3))]).astype(np.float32)
    sdf = (np.linalg.norm(points, axis=1) - radius).astype(np.float32)
    surface = (radius * outward / np.linalg.norm(outward, axis=1, keepdims=True)).astype(np.float32)
    return SdfSamples(f"ball{radius}", points, sdf, np.full(3, 2 * radius), surface)


BALLS = Corpus(tuple(ball(r, i) for i, r in enumerate(np.linspace(0.2, 0.45, 8))), (), (), (), {})


def with_optimiser(config: TrainConfig, **changes) -> TrainConfig:
    return replace(config, optimiser=replace(config.optimiser, **changes))


def weights(trained) -> list[np.ndarray]:
    return [
        trained.codes,
        trained.code_mean,
        trained.code_covariance,
        *(value.numpy() for value in trained.decoder.state_dict().values()),
    ]


def test_loss_falls_and_an_unseen_size_is_found(config: TrainConfig) -> None:
    config = with_optimiser(replace(config, steps=600), points_per_shape=64, cooldown=0.5)
    losses: list[float] = []
    trained = train(config, BALLS, lambda _, loss: losses.append(loss))
    assert losses[-1] < 0.8 * losses[0]  # of the worst samples
    error = fit_error(prior_of(trained), ball(0.33, 99), 48)
    assert error.chamfer < 0.06
    assert error.bands["0-0.005"] < 0.03
    assert 0.7 < error.gradient_median < 1.3


def test_in_the_box_frame_all_balls_are_one(config: TrainConfig) -> None:
    corpus = replace(BALLS, training=tuple(squeezed(ball(0.3, i), i) for i in range(8)))
    config = with_optimiser(
        replace(config, normalisation="box", steps=600), points_per_shape=64, cooldown=0.5
    )
    trained = train(config, corpus)
    assert trained.box is not None
    assert np.linalg.norm(trained.box.extents) == pytest.approx(1)
    assert trained.box.anisotropy_sigma > 0.05
    prior = prior_of(trained)
    unseen = squeezed(ball(0.3, 99), 99)
    decoded = extract_mesh(prior.decoder, prior.code_mean, 48)
    assert_allclose(decoded.extents, trained.box.extents, atol=0.06)
    assert fit_error(prior, unseen, 48).chamfer < 0.05


def squeezed(shape: SdfSamples, seed: int) -> SdfSamples:
    """A ball made an ellipsoid, with the distances near its surface to first order."""
    factors = np.exp(np.random.default_rng(seed).uniform(-0.3, 0.3, 3)).astype(np.float32)
    points = shape.points * factors
    normal = shape.points / np.linalg.norm(shape.points, axis=1, keepdims=True) / factors
    sdf = shape.sdf / np.linalg.norm(normal, axis=1)
    assert shape.surface is not None
    return SdfSamples(shape.name, points, sdf, shape.extents * factors, shape.surface * factors)


def prior_of(trained: Trained) -> ShapePrior:
    box = trained.box
    return ShapePrior(
        "ball",
        trained.decoder,
        trained.code_mean,
        trained.code_covariance,
        residual_sigma=0.01,
        size_mean=1.0,
        size_log_sigma=0.2,
        box=None if box is None else box.extents,
    )


def test_sign_errors_are_torchs_own() -> None:
    generator = torch.Generator().manual_seed(0)
    prediction, sdf = 0.02 * torch.randn(2, 50, generator=generator).double()
    inside = Bernoulli(logits=-prediction / 0.01).log_prob((sdf < 0).double())
    torch.testing.assert_close(sign_errors(prediction, sdf, 0.01), -inside)


@pytest.mark.parametrize("count", [8, 60])
def test_killed_training_resumes_with_the_same_result(
    config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    monkeypatch.setattr("objgraph.training.decoder.train._REFIT", 3)
    balls = replace(
        BALLS, training=tuple(ball(r, i, 100) for i, r in enumerate(np.linspace(0.2, 0.45, count)))
    )
    whole = train(replace(config, out=tmp_path / "whole"), balls)
    assert (0 if whole.kinds is None else len(whole.kinds.weight)) == {8: 0, 60: 7 + 1}[count]
    config = replace(config, checkpoint_seconds=0.0)

    def die() -> None:
        def kill(step: int, loss: float) -> None:
            if step == 7:
                os.kill(os.getpid(), signal.SIGKILL)

        train(config, balls, kill)

    child = multiprocessing.get_context("fork").Process(target=die)
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert checkpoint_path(config).is_file()
    resumed = train(config, balls)
    assert resumed.step == 12
    for ours, theirs in zip(weights(resumed), weights(whole), strict=True):
        assert_array_equal(ours, theirs)
    assert [path.name for path in config.out.iterdir() if path.is_file()] == ["chair.checkpoint"]


def test_other_settings_do_not_resume_a_checkpoint(config: TrainConfig) -> None:
    train(config, BALLS)
    train(replace(config, steps=14), BALLS)
    with pytest.raises(PriorError, match=r"chair\.checkpoint is the checkpoint of another training"):
        train(replace(config, seed=1), BALLS)
    with pytest.raises(PriorError, match="another training"):
        train(config, replace(BALLS, training=BALLS.training[:5]))


@pytest.mark.parametrize("what", ["samples", "names", "order"])
def test_other_shapes_do_not_resume_a_checkpoint_though_they_are_as_many(
    config: TrainConfig, what: str
) -> None:
    train(config, BALLS)
    others = {
        "samples": (replace(BALLS.training[0], sdf=BALLS.training[0].sdf + 0.01), *BALLS.training[1:]),
        "names": (replace(BALLS.training[0], name="another"), *BALLS.training[1:]),
        "order": BALLS.training[::-1],
    }
    with pytest.raises(PriorError, match="another training"):
        train(config, replace(BALLS, training=others[what]))


def test_truncated_checkpoint_is_named(config: TrainConfig) -> None:
    train(config, BALLS)
    path = checkpoint_path(config)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(PriorError, match=r"chair\.checkpoint is missing, damaged"):
        train(config, BALLS)


def test_nan_stops_the_training_and_writes_nothing(config: TrainConfig) -> None:
    bad = ball(0.3, 0)
    bad.sdf[:] = np.nan
    with pytest.raises(PriorError, match="the loss is nan at step 0"):
        train(config, replace(BALLS, training=(bad, bad, bad, bad)))
    assert not list(config.out.iterdir())


def test_bfloat16_learns_as_float32_does(config: TrainConfig) -> None:
    config = with_optimiser(replace(config, steps=100), points_per_shape=64)
    whole = train(replace(config, out=config.out / "whole"), BALLS)
    half = train(replace(config, bf16=1.0), BALLS)
    assert half.loss != whole.loss
    assert half.loss == pytest.approx(whole.loss, rel=0.05)


def test_unusable_device_is_named(config: TrainConfig) -> None:
    with pytest.raises(PriorError, match="device 'nowhere' cannot be used"):
        train(replace(config, device="nowhere"), BALLS)


def test_nothing_to_train_on(config: TrainConfig) -> None:
    with pytest.raises(PriorError, match="no chair to train on"):
        train(config, replace(BALLS, training=()))


def test_learning_rates_rise_stay_and_fall() -> None:
    config = TrainConfig(steps=1000, optimiser=OptimiserConfig(warmup=100, cooldown=0.4))
    shares = [schedule(config, step) for step in (0, 99, 500, 800, 999)]
    assert shares[0] == pytest.approx(0.01)
    assert shares[1:3] == [1.0, 1.0]
    assert shares[3] == pytest.approx(0.5)
    assert shares[4] == pytest.approx(0.02)


def test_meshes_to_prior(meshes: Path, config: TrainConfig) -> None:
    config = replace(
        config,
        category="table",
        meshes=(meshes,),
        corpus=CorpusConfig(procedural=4, copies=1, swaps=3, procedural_heldout=4),
        samples=SampleConfig(count=600),
    )
    path = train_command(config)
    prior = load_prior(path)
    assert prior.category == "table"
    assert prior.code_mean.shape == (4,)
    assert np.linalg.eigvalsh(prior.code_covariance).min() > 0
    assert prior.residual_sigma > 0
    assert 1.0 < prior.size_mean < 2.0
    data, heldout = prior.card["data"], prior.card["heldout"]
    used = {name for entry in data["collected"] for name in entry["files"]}
    assert "t4.ply" in data["skipped"] or "t4.ply" in heldout["collected"]
    assert used.isdisjoint(heldout["collected"])
    assert heldout["summary"]["count"] == len(heldout["collected"]) > 0
    text = attribution([prior])
    assert all(name in text for name in used)
    assert ": box" in text


@pytest.mark.parametrize(
    "makers", [("people", "generator"), ("generator", "people"), ("generator", "generator")]
)
def test_what_a_prior_leaves_out_is_measured_on_what_people_made(
    config: TrainConfig, makers: tuple[str, str]
) -> None:
    unseen = tuple(
        CadMesh(Path(), f"{i}.ply", f"boxes:{i}", "CC0-1.0", "", "boxes", None, maker)
        for i, maker in enumerate(makers)
    )
    heldout = tuple(replace(ball(r, i), name=f"{i}.ply#0") for i, r in enumerate((0.25, 0.44)))
    corpus = replace(BALLS, heldout=heldout, unseen=unseen)
    prior = make_prior(config, corpus, train(config, corpus))
    errors = [next(iter(error["bands"].values())) for error in prior.card["heldout"]["errors"]]
    chosen = [
        e for e, maker in zip(errors, makers, strict=True) if maker == "people" or "people" not in makers
    ]
    assert len(errors) == 2
    assert abs(errors[0] - errors[1]) > 1e-4
    assert prior.residual_sigma == pytest.approx(np.median(chosen), rel=1e-3)


@pytest.mark.parametrize("few", [0, 1])
def test_meshes_as_they_are_say_what_codes_tell_of_proportions(few: int) -> None:
    rng = np.random.default_rng(0)
    count = FEWEST - few
    codes = rng.normal(size=(count, 2))
    box = np.array([0.6, 0.5, np.sqrt(0.39)])
    extents = box * np.exp(np.outer(codes[:, 0], [0.0, 0.2, 0.0]))
    meshes = [CadMesh(Path(), f"{i}.ply", f"{i}", "", "", "boxes", None) for i in range(count)]
    shapes = [replace(ball(0.3, i), name=f"{i}.ply#0", extents=extents[i]) for i in range(count)]
    others = [replace(ball(0.3, 0), name=name) for name in ("0.ply#1", "swap/0.ply+1.ply#0", "family 0")]
    trained = Trained(
        decoder=Decoder(DecoderConfig(code_length=2, width=8, depth=2, skip=1)), codes=np.concatenate([codes, 9 * rng.normal(size=(3, 2))]),
        code_mean=np.zeros(2), code_covariance=np.eye(2), kinds=None, box=BoxFrame(box, 0.2), step=1, loss=0.0,
    )  # fmt: skip
    corpus = Corpus((*shapes, *others), (), tuple(meshes), (), {})
    found = _proportions(corpus, trained)
    assert (found is None) == (few > 0)
    if found is not None:
        assert_allclose(found.slope, [[0, 0], [0.2, 0], [0, 0]], atol=0.01)
    assert _proportions(corpus, replace(trained, box=None)) is None


def test_held_out_shapes_are_fitted_by_all_jobs_and_kept_in_order(
    config: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, told = [], []

    def backwards(works, workers):
        jobs.append(workers.jobs)
        yield from ((i, works[i]()) for i in reversed(range(len(works))))

    monkeypatch.setattr("objgraph.training.export.spread", backwards)
    monkeypatch.setattr(
        "objgraph.training.export.fit_error",
        lambda prior, shape: FitError(shape.name, 0.1, {"0-1": 0.1}, 1.0),
    )
    unseen = tuple(
        CadMesh(Path(), f"{i}.ply", f"{i}", "CC0-1.0", "", "boxes", None, "people") for i in range(3)
    )
    heldout = tuple(replace(ball(0.3, i), name=f"{i}.ply#0") for i in range(3))
    corpus = replace(BALLS, heldout=heldout, unseen=unseen)
    prior = make_prior(
        replace(config, jobs=2), corpus, train(config, corpus), lambda *what: told.append(what)
    )
    assert [error["name"] for error in prior.card["heldout"]["errors"]] == [shape.name for shape in heldout]
    assert jobs == [2]
    assert told == [("fitting held-out shapes", i, 3) for i in (1, 2, 3)]


def test_a_held_out_mesh_counts_whatever_its_name(
    config: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "objgraph.training.export.fit_error",
        lambda prior, shape: FitError(shape.name, 0.1, {"0-1": 0.1}, 1.0),
    )
    entry = CadMesh(Path(), "sofa #1.ply", "sofa #1.ply", "CC0-1.0", "", "", None)
    names = ("sofa #1.ply#0", "procedural/sofa_0_0024")
    heldout = tuple(replace(ball(0.3, i), name=name) for i, name in enumerate(names))
    corpus = replace(BALLS, heldout=heldout, unseen=(entry,))
    card = make_prior(config, corpus, train(config, corpus)).card["heldout"]
    assert [error["name"] for error in card["errors"]] == ["sofa #1.ply#0"]
    assert (card["summary"]["count"], card["procedural"]["count"]) == (1, 1)


def test_where_nothing_is_held_out_it_is_said_that_the_residual_is_a_guess(
    config: TrainConfig, caplog: pytest.LogCaptureFixture
) -> None:
    prior = make_prior(config, BALLS, train(config, BALLS))
    assert prior.card["residual_source"] == "a guess, not measured"
    assert "no shape was held out to measure the prior on" in caplog.text


def test_the_first_guess_has_the_threads_of_the_training(
    config: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = []

    def guessed(prior, *_):
        used.append(torch.get_num_threads())
        return prior

    monkeypatch.setattr("objgraph.training.export._corpus", lambda _: BALLS)
    monkeypatch.setattr("objgraph.training.export.with_first_guess", guessed)
    before = torch.get_num_threads()
    train_command(replace(config, threads=before + 1, guess=TrainGuessConfig(steps=1)))
    assert used == [before + 1]
    assert torch.get_num_threads() == before


def test_shapes_of_equal_proportions_leave_room_for_others() -> None:
    assert BoxFrame.of(np.tile([0.5, 0.5, 0.7], (3, 1))).anisotropy_sigma == LEAST_SIGMA


def test_training_leaves_the_global_generator_alone(config: TrainConfig) -> None:
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    train(config, BALLS)
    assert_array_equal(torch.rand(2).numpy(), expected.numpy())
