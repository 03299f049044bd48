"""What a training reads: experiment folders of DeepSDF, and folders of meshes with an index."""

import json
from pathlib import Path

import pytest
import torch
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from objgraph.training.convert import ConvertConfig, convert
from objgraph.training.meshes.files import SUFFIXES, canonical, read_mesh
from objgraph.training.meshes.folder import choose_meshes
from objgraph.training.meshes.index import heldout_groups, read_index
from tests.fuzz.inputs import attempt, files_in, fuzzed, replaced
from tests.fuzz.strategies import damaged
from tests.objgraph.training.test_convert import LENGTH, Reference, write
from tests.toys import toy_prior


@pytest.fixture(scope="module")
def experiment(tmp_path_factory) -> Path:
    torch.manual_seed(0)
    network = Reference(torch.nn.utils.weight_norm)
    return write(tmp_path_factory.mktemp("experiment") / "a", network, torch.randn(4, 1, LENGTH))


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> Path:
    """A box in each format, and the index that lists them."""
    folder, box = tmp_path_factory.mktemp("meshes"), trimesh.creation.box([0.4, 0.8, 0.4])
    entries = []
    for suffix in SUFFIXES:
        box.export(folder / f"box{suffix}")
        entries.append(
            {
                "file": f"box{suffix}", "group": suffix, "licence": "CC0", "attribution": "-", "source_repo": "-",
                "size_m": [0.4, 0.8, 0.4], "made_by": "people", "kind": "", "split": "train", "category": "chair",
            }
        )  # fmt: skip
    (folder / "index.json").write_text(json.dumps({"meshes": entries}))
    use(folder)
    return folder


def use(folder: Path) -> None:
    """All that an index says, and every mesh that it lists."""
    listed = read_index(folder, "chair")
    heldout_groups(listed, 0.2)
    chosen = choose_meshes([folder], "chair", toy_prior())
    for path, name in zip(chosen.paths, chosen.names, strict=True):
        assert path.resolve().is_relative_to(folder.resolve())
        canonical(read_mesh(path), name)


@fuzzed
@given(data=st.data())
def test_a_damaged_experiment(experiment, data):
    path = data.draw(st.sampled_from(files_in(experiment)))
    with replaced(experiment, path, data.draw(damaged(path))):
        attempt(convert, ConvertConfig(experiment, "chair", experiment / "out.safetensors"))


@fuzzed
@given(data=st.data())
def test_a_damaged_folder_of_meshes(meshes, data):
    path = data.draw(st.sampled_from(files_in(meshes)))
    with replaced(meshes, path, data.draw(damaged(path))):
        attempt(use, meshes)


@fuzzed
@given(data=st.data())
def test_a_damaged_mesh(meshes, data):
    path = data.draw(st.sampled_from([meshes / f"box{suffix}" for suffix in SUFFIXES]))
    with replaced(meshes, path, data.draw(damaged(path))):
        attempt(lambda: canonical(read_mesh(path), path.name))
