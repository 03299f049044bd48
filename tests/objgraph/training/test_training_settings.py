"""Settings of a training that mean nothing are named before anything is sampled."""

from collections.abc import Callable
from pathlib import Path

import pytest

from objgraph.cli.main import main
from objgraph.errors import ConfigError, PriorError
from objgraph.priors.first_guess import FirstGuessConfig
from objgraph.training.codes.partial import PartialConfig
from objgraph.training.codes.search import SearchConfig
from objgraph.training.codes.single_view import SingleViewConfig
from objgraph.training.decoder.losses import LossConfig
from objgraph.training.decoder.train import OptimiserConfig, TrainConfig
from objgraph.training.guess.command import GuessCommand
from objgraph.training.guess.scenes import SceneConfig
from objgraph.training.guess.train import TrainGuessConfig
from objgraph.training.meshes.corpus import CorpusConfig
from objgraph.training.meshes.samples import SampleConfig
from objgraph.training.quality.evaluate import PriorEvaluationConfig


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: OptimiserConfig(shapes_per_step=0), "shapes_per_step"),
        (lambda: OptimiserConfig(learning_rate=float("nan")), "learning_rate"),
        (lambda: OptimiserConfig(cooldown=1.5), "cooldown"),
        (lambda: TrainConfig(steps=0), "steps"),
        (lambda: TrainConfig(normalisation="sphere"), "normalisation"),  # type: ignore[arg-type]
        (lambda: TrainConfig(code_weight=-1e-5), "code_weight"),
        (lambda: CorpusConfig(heldout_share=2.0), "heldout_share"),
        (lambda: CorpusConfig(procedural_heldout=0), "procedural_heldout"),
        (lambda: SampleConfig(count=1), "count"),
        (lambda: SampleConfig(near_share=0.5, far_share=0.5, box_share=0.1), "add up to 1.1"),
        (lambda: LossConfig(sign_scale=0.0), "sign_scale"),
        (lambda: TrainGuessConfig(batch=0), "batch"),
        (lambda: SceneConfig(wall=-0.1), "wall"),
        (lambda: GuessCommand("chair", Path("out"), shapes=0), "shapes"),
        (lambda: SearchConfig(kept=0), "kept"),
        (lambda: GuessCommand("chair", Path("out"), threads=0), "threads"),
        (lambda: PriorEvaluationConfig(resolution=0), "resolution"),
        (lambda: PriorEvaluationConfig(bound=0.0), "bound"),
        (lambda: PriorEvaluationConfig(seed=-1), "seed"),
        (lambda: PartialConfig(surface_points=0), "surface_points"),
        (lambda: PartialConfig(free_sigma=0.0), "free_sigma"),
        (lambda: SingleViewConfig(width=1), "width"),
        (lambda: SingleViewConfig(distance=(0.5, 2.0)), r"distance\[0\]"),
        (lambda: SingleViewConfig(elevation=(15.0, 90.0)), r"elevation\[1\]"),
    ],
)
def test_what_means_nothing_is_named(make: Callable[[], object], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        make()


def test_a_network_without_points_is_none() -> None:
    with pytest.raises(PriorError, match="surface"):
        FirstGuessConfig(surface=0)


def test_the_command_line_says_it_in_a_line(tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    with pytest.raises(SystemExit, match="2"):
        main(["train", "--category", "table", "--optimiser.points-per-shape", "0", "--out", str(out)])
    assert "points_per_shape must be at least 1" in capsys.readouterr().err
    assert not out.exists()
