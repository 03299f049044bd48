"""Training: it learns, resumes bit for bit after a kill, and stops cleanly where it must."""

import json
import multiprocessing
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from torch.distributions import Bernoulli

from factors.decoder import DecoderConfig
from objgraph.errors import PriorError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.corpus import Corpus, CorpusConfig, build_corpus
from objgraph.training.export import attribution, make_prior, train_command
from objgraph.training.fit import fit_error
from objgraph.training.index import CadMesh, heldout_groups, read_index
from objgraph.training.losses import sign_errors
from objgraph.training.samples import SampleConfig, SdfSamples
from objgraph.training.train import (
    OptimiserConfig,
    TrainConfig,
    Trained,
    checkpoint_path,
    schedule,
    train,
)
from objgraph.training.train_guess import TrainGuessConfig


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


@pytest.fixture
def config(tmp_path: Path) -> TrainConfig:
    return TrainConfig(
        category="chair",
        out=tmp_path,
        decoder=DecoderConfig(code_length=4, width=32, depth=3, skip=1),
        normalisation="diagonal",
        steps=12,
        optimiser=OptimiserConfig(
            shapes_per_step=4, points_per_shape=16, warmup=3, learning_rate=3e-3, average_decay=0.9
        ),
        guess=TrainGuessConfig(steps=0),
    )


def with_optimiser(config: TrainConfig, **changes) -> TrainConfig:
    return replace(config, optimiser=replace(config.optimiser, **changes))


def weights(trained) -> list[np.ndarray]:
    return [
        trained.codes,
        trained.kinds.mean,
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
        np.zeros(trained.codes.shape[1]),
        np.eye(trained.codes.shape[1]),
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
    monkeypatch.setattr("objgraph.training.train._REFIT", 3)
    balls = replace(
        BALLS, training=tuple(ball(r, i, 100) for i, r in enumerate(np.linspace(0.2, 0.45, count)))
    )
    whole = train(replace(config, out=tmp_path / "whole"), balls)
    assert len(whole.kinds.weight) == {8: 1, 60: 7 + 1}[count]
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
    half = train(replace(config, bf16=True), BALLS)
    assert half.loss != whole.loss
    assert half.loss == pytest.approx(whole.loss, rel=0.05)


def test_unusable_device_is_named(config: TrainConfig) -> None:
    with pytest.raises(PriorError, match="device 'nowhere' cannot be used"):
        train(replace(config, device="nowhere"), BALLS)


def test_nothing_to_train_on(config: TrainConfig) -> None:
    with pytest.raises(PriorError, match="no chair to train on"):
        train(config, replace(BALLS, training=()))


def test_meshes_without_the_libraries_for_them_are_refused_before_any_work(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(PriorError, match=r"meshes need manifold3d: pip install 'objgraph\[train\]'"):
        build_corpus("chair", [tmp_path], CorpusConfig(), SampleConfig(), tmp_path)


def test_learning_rates_rise_stay_and_fall() -> None:
    config = TrainConfig(steps=1000, optimiser=OptimiserConfig(warmup=100, cooldown=0.4))
    shares = [schedule(config, step) for step in (0, 99, 500, 800, 999)]
    assert shares[0] == pytest.approx(0.01)
    assert shares[1:3] == [1.0, 1.0]
    assert shares[3] == pytest.approx(0.5)
    assert shares[4] == pytest.approx(0.02)


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    """A folder of five tables in three groups, one of them unreadable."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    entries = []
    for i, group in enumerate("aabca"):
        name = f"t{i}.ply"
        trimesh.creation.box((0.6 + 0.05 * i, 0.3, 0.5)).export(folder / name)
        entry = {
            "file": name,
            "category": "table",
            "group": group,
            "licence": "CC0-1.0",
            "attribution": f"box {i}",
        }
        entries.append({**entry, "source_repo": "boxes/boxes", "size_m": [1.2, 0.6, 1.0]})
    (folder / "t4.ply").write_bytes(b"ply\nnothing")
    (folder / "index.json").write_text(json.dumps({"meshes": entries}))
    return folder


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


def collected(sources: dict[str, list[str]]) -> list[CadMesh]:
    """Entries whose groups are given by source."""
    return [
        CadMesh(Path(), f"{source}/{i}.ply", f"{source}:{group}", "CC0-1.0", "", source, None)
        for source, groups in sources.items()
        for i, group in enumerate(groups)
    ]


@given(
    st.dictionaries(
        st.sampled_from("abcdef"),
        st.lists(st.sampled_from("123456789"), min_size=1, max_size=12),
        min_size=1,
    ),
    st.floats(0.05, 0.45),
)
def test_every_source_holds_out_its_share_by_whole_groups(
    sources: dict[str, list[str]], share: float
) -> None:
    entries = collected(sources)
    held = heldout_groups(entries, share)
    assert held == heldout_groups(entries[::-1], share)
    for source in sources:
        own = [entry for entry in entries if entry.source == source]
        if len({entry.group for entry in own}) > 1:
            assert sum(entry.group in held for entry in own) >= share * len(own)
    assert heldout_groups(entries, 0.0) == set()


def test_validation_never_sees_what_is_held_out(meshes: Path, tmp_path: Path) -> None:
    (meshes / "t4.ply").write_bytes((meshes / "t0.ply").read_bytes())
    entries = read_index(meshes, "table")
    held = heldout_groups(entries, 0.2)
    settings = CorpusConfig(procedural=0, swaps=0, copies=0, validation=True)
    corpus = build_corpus("table", [meshes], settings, SampleConfig(count=600), tmp_path)
    assert corpus.used
    assert corpus.unseen
    assert held.isdisjoint(entry.group for entry in corpus.used + corpus.unseen)


@pytest.mark.parametrize(
    "content", [None, "{", "[]", '{"meshes": [{"category": "table"}]}', '{"meshes": []}']
)
def test_bad_index_is_named(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "index.json").write_text(content)
    with pytest.raises(PriorError, match=r"index\.json"):
        read_index(tmp_path, "table")


@pytest.mark.parametrize(
    "change",
    [
        {"group": None},
        {"licence": 3},
        {"kind": None},
        {"size_m": [1, 2]},
        {"size_m": "abc"},
        {"size_m": [1, 0, 1]},
        {"file": None},
    ],
)
def test_an_entry_of_other_values_is_named(tmp_path: Path, change: dict) -> None:
    names = ("file", "group", "licence", "attribution", "source_repo", "category")
    entry = {**dict.fromkeys(names, "table"), "size_m": None}
    (tmp_path / "index.json").write_text(json.dumps({"meshes": [entry]}))
    assert len(read_index(tmp_path, "table")) == 1
    (tmp_path / "index.json").write_text(json.dumps({"meshes": [entry | change]}))
    with pytest.raises(PriorError, match=r"index\.json is no mesh index"):
        read_index(tmp_path, "table")


def test_any_folder_of_meshes_will_do(tmp_path: Path) -> None:
    folder = tmp_path / "lamp"
    folder.mkdir()
    (tmp_path / "sofa").mkdir()
    for i in range(6):
        shade = trimesh.creation.cylinder(0.2 + 0.1 * i, 3.0)
        shade.apply_translation([5, 0, 1])
        shade.export(folder / f"{i}.stl")
    trimesh.creation.box().export(tmp_path / "sofa" / "box.obj")
    settings = CorpusConfig(procedural=0, copies=0)
    corpus = build_corpus("lamp", [tmp_path], settings, SampleConfig(count=600), tmp_path / "cache")
    assert {entry.file for entry in corpus.used + corpus.unseen} == {f"lamp/{i}.stl" for i in range(6)}
    assert corpus.unseen
    for shape in corpus.training:
        assert np.linalg.norm(shape.extents) == pytest.approx(1)
        assert np.abs(shape.points[np.abs(shape.sdf) < 1e-3]).max() < 0.51


def test_processes_sample_the_same_shapes_from_several_folders(meshes: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "table"
    other.mkdir(parents=True)
    trimesh.creation.cylinder(0.5, 0.4).export(other / "round.ply")
    (other / "flat.ply").write_text("no mesh")
    folders, settings = [meshes, other.parent], CorpusConfig(procedural=6, copies=1, swaps=2)
    one, two = (
        build_corpus("table", folders, settings, SampleConfig(count=300), tmp_path / f"cache{jobs}", jobs)
        for jobs in (1, 2)
    )
    assert {entry.folder for entry in one.used + one.unseen} == set(folders)
    assert [entry.file for entry in one.used] == [entry.file for entry in two.used]
    assert set(one.skipped) == set(two.skipped) == {"t4.ply", "table/flat.ply"}
    for a, b in zip(one.training + one.heldout, two.training + two.heldout, strict=True):
        assert a.name == b.name
        assert_array_equal(a.points, b.points)
        assert_array_equal(a.sdf, b.sdf)


def test_unknown_category_needs_meshes(tmp_path: Path) -> None:
    with pytest.raises(PriorError, match=r"'lamp' has no procedural family \(chair, table, car\)"):
        build_corpus("lamp", [], CorpusConfig(), SampleConfig(), tmp_path)


def test_training_leaves_the_global_generator_alone(config: TrainConfig) -> None:
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    train(config, BALLS)
    assert_array_equal(torch.rand(2).numpy(), expected.numpy())
