"""The long commands at their smallest, and what of their outcomes is the same in every run."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import safetensors.numpy

import objgraph.cli.calibrate
import objgraph.cli.evaluate
import objgraph.cli.map
import objgraph.cli.report
import objgraph.cli.segment
import objgraph.cli.sensor
import objgraph.training.export
import objgraph.training.guess.command  # noqa: F401
from objgraph.atomic import UNFINISHED
from objgraph.cli.main import main
from objgraph.datasets import scannet
from objgraph.observation.frames import Scan
from objgraph.segment.mask2former import Segmenter
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.objgraph.cli.test_calibrate import rows, written
from tests.objgraph.datasets.dataset_folders import write_plain_folder
from tests.objgraph.segment.test_segment import Network, by_color, write_folder

_SAMPLE = SampleConfig(camera=CameraConfig(frames=8, width=160, height=120))
_TIMES = {"seconds", "seconds_cpu", "start_seconds", "seconds_by_stage"}
_WITH_TIMES = ("objects.csv", "tables.md", "figures.json", "report.html")
"""What shows times as well: only that it is there is compared; the rows are."""


@dataclass(frozen=True)
class Command:
    """One of them by its name, on inputs in the folder `given`."""

    name: str
    given: Path

    def prepare(self, out: Path) -> None:
        """What is in its folder before the first run."""
        if self.name == "segment":
            out.mkdir()
            write_folder(out)
        elif self.name == "report":
            shutil.copytree(self.given / "map", out)

    def __call__(self, out: Path) -> int:
        if self.name == "segment":
            patch = pytest.MonkeyPatch()  # of a process that ends afterwards
            patch.setattr(Segmenter, "load", classmethod(lambda cls, weights, device: Segmenter(Network())))
            patch.setattr(Segmenter, "segment", by_color)
        return main(ARGUMENTS[self.name](self.given, out))


def write_inputs(given: Path) -> None:
    """A scan with but one chair, and rows of made-up objects."""
    written(given / "rows", rows())
    whole = scannet.load(generate_sample(given / "sample", _SAMPLE) / "scannet")
    chairs = [each for each in whole.instances if each.category == "chair"]
    pixels = [
        sum(int(np.count_nonzero(whole.frames[i].instances == each.id)) for i in range(_SAMPLE.camera.frames))
        for each in chairs
    ]
    write_plain_folder(
        given / "scan", Scan(whole.name, whole.frames, (chairs[int(np.argmax(pixels))],), whole.up_world)
    )


def _map(given: Path, out: Path) -> list[str]:
    few = ["--views", "1", "--mesh-resolution", "16", "--categories", "chair", "--min-pixels", "40"]
    return ["map", "--dataset", "folder", "--root", str(given / "scan"), "--out", str(out), *few]


def _evaluate(given: Path, out: Path) -> list[str]:
    few = ["--objects", "2", "--categories", "chair", "--views", "1", "--methods", "start,start-7dof"]
    return ["evaluate", *few, "--out", str(out)]


def _train(given: Path, out: Path) -> list[str]:
    corpus = "--corpus.procedural 6 --corpus.procedural-heldout 6 --samples.count 300"
    network = "--decoder.code-length 4 --decoder.width 16 --decoder.depth 3 --decoder.skip 1"
    steps = "--steps 30 --optimiser.shapes-per-step 4 --optimiser.points-per-shape 16 --optimiser.warmup 3"
    words = f"--category table {corpus} {network} {steps} --guess.steps 0 --checkpoint-seconds 0"
    return ["train", *words.split(), "--out", str(out)]


def _train_guess(given: Path, out: Path) -> list[str]:
    network = " ".join(
        f"--guess.network.{name} 32" for name in ("surface", "free", "heading-width", "place-width", "hidden")
    )
    words = f"--guess.scenes 6 --guess.steps 12 --guess.batch 4 {network}"
    prior = ["--prior", "bathtub", "--out", str(out / "guess.safetensors"), "--work", str(out / "work")]
    return ["train-guess", *prior, *words.split(), "--guess.checkpoint-every", "3"]


ARGUMENTS: dict[str, Callable[[Path, Path], list[str]]] = {
    "map": _map,
    "report": lambda given, out: ["report", str(out)],
    "segment": lambda given, out: ["segment", "--root", str(out), "--up", "0", "-1", "0"],
    "calibrate": lambda given, out: ["calibrate", str(given / "rows"), "--out", str(out / "known.json")],
    "sensor": lambda given, out: ["sensor", "--root", str(given / "scan"), "--out", str(out / "sensor.json")],
    "evaluate": _evaluate,
    "train": _train,
    "train-guess": _train_guess,
}
"""What is typed, by inputs and folder; the cheapest first."""


def outcome(out: Path, exact: bool = False) -> dict[str, Any]:
    """All files of a folder by name: bytes, or of documents what is in them but for times."""
    return {
        str(path.relative_to(out)): path.read_bytes() if exact else _content(path)
        for path in sorted(out.rglob("*"))
        if not path.is_dir()
    }


def check_whole(out: Path) -> None:
    """Every file that has its name can be read to its end."""
    for path in out.rglob("*"):
        if path.is_dir() or UNFINISHED in str(path):
            continue
        if path.suffix == ".png":
            assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED) is not None, path
        elif path.suffix in (".safetensors", ".checkpoint"):
            safetensors.numpy.load_file(path)
        elif path.suffix == ".html":
            assert path.read_text().rstrip().endswith("</html>"), path
        else:
            _content(path)


def _content(path: Path) -> Any:
    if path.name in _WITH_TIMES:
        return path.stat().st_size > 0
    if path.suffix == ".jsonl":
        return [_timeless(json.loads(line)) for line in path.read_text().splitlines()]
    if path.suffix == ".json":
        return _timeless(json.loads(path.read_text()))
    return path.read_bytes()


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(each) for key, each in value.items() if key not in _TIMES}
    return [_timeless(each) for each in value] if isinstance(value, list) else value
