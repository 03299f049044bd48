"""One object of a small synthetic scan is mapped by the command from each layout, to the same place."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from objgraph.cli.main import main
from objgraph.datasets import scannet
from objgraph.observation.frames import Scan
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.objgraph.datasets.bag_files import write_recording
from tests.objgraph.datasets.dataset_folders import write_bop, write_nerfstudio, write_plain_folder

SAMPLE = SampleConfig(camera=CameraConfig(frames=6, width=160, height=120))
FEW = ["--views", "1", "--mesh-resolution", "16", "--categories", "chair", "--min-pixels", "40"]
LAYOUTS: dict[str, Callable[[Path, Scan], object]] = {
    "bag": write_recording,
    "bop": write_bop,
    "nerfstudio": write_nerfstudio,
}


def mapped_at(dataset: str, root: Path, out: Path) -> np.ndarray:
    """Where the chairs are, (n, 3)."""
    assert main(["map", "--dataset", dataset, "--root", str(root), "--out", str(out), *FEW]) == 0
    objects = json.loads((out / "map.json").read_text())["objects"]
    found = [np.array(each["T_world_object"])[:3, 3] for each in objects if each["status"] == "mapped"]
    assert found
    return np.array(found)


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Scan:
    """A sample with but one chair, so that few seconds do."""
    whole = scannet.load(generate_sample(tmp_path_factory.mktemp("sample") / "sample", SAMPLE) / "scannet")
    chairs = [each for each in whole.instances if each.category == "chair"]
    seen = [
        sum((frame.instances == each.id).sum() for frame in map(whole.frames.__getitem__, range(6)))
        for each in chairs
    ]
    return Scan(whole.name, whole.frames, (chairs[int(np.argmax(seen))],), whole.up_world)


@pytest.fixture(scope="module")
def expected(scan, tmp_path_factory) -> np.ndarray:
    folder = tmp_path_factory.mktemp("plain")
    return mapped_at("folder", write_plain_folder(folder / "scan", scan), folder / "out")


@pytest.mark.parametrize("dataset", LAYOUTS)
def test_an_object_is_mapped_to_the_same_place(dataset, scan, expected, tmp_path):
    LAYOUTS[dataset](tmp_path / "scan", scan)
    np.testing.assert_allclose(mapped_at(dataset, tmp_path / "scan", tmp_path / "out"), expected, atol=0.02)
