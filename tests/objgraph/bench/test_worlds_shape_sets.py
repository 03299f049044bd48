"""The benchmark's sets of shapes from a folder with an index: who made them, what is held out, how large they are."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from objgraph.bench.worlds.cases import BenchmarkConfig, synthetic_cases
from objgraph.errors import DatasetError
from objgraph.training.meshes.index import HELDOUT_SHARE, heldout_groups, read_index
from tests.objgraph.bench.test_worlds_cases import SEED, p_world


@pytest.fixture
def collected(tmp_path) -> Path:
    """A folder with an index: meshes of people and of a generator's two kinds, some groups of two."""
    entries = []
    for maker, source, kinds in (("people", "a/b", [""]), ("generator", "g/h", ["bar", "arm"])):
        for kind in kinds:
            for i in range(10):
                name = f"chair/{maker}{kind}{i}.ply"
                (tmp_path / "chair").mkdir(exist_ok=True)
                trimesh.creation.box(extents=(0.5, 0.9 + 0.01 * i, 0.5)).export(tmp_path / name)
                entry = {
                    "file": name, "category": "chair", "group": f"{maker}{kind}{i // 2}", "licence": "CC0", "attribution": "x",
                    "source_repo": source, "size_m": [0.5, 0.9, 0.55], "made_by": maker, "split": "train",
                }  # fmt: skip
                entries.append(entry | ({"kind": kind} if kind else {}))
    (tmp_path / "index.json").write_text(json.dumps({"meshes": entries}))
    return tmp_path


def test_sets_of_shapes_are_held_out_and_apart(collected):
    found = {}
    for shapes in ("cad", "everyday"):
        config = BenchmarkConfig(
            seed=SEED, objects=30, categories=("chair",), meshes=collected, shapes=shapes
        )
        cases = synthetic_cases(config)
        found[shapes] = {case.shape for case in cases}
        assert all(case.shapes == shapes for case in cases)
        assert all(
            case.mesh.diagonal_m == pytest.approx(np.linalg.norm([0.5, 0.9, 0.55]))
            for case in cases
            if case.mesh
        )
    assert all(name.startswith("chair/people") for name in found["cad"])
    assert all(name.startswith("chair/generator") for name in found["everyday"])
    # one group in five of every source and kind, which has two meshes
    assert len(found["cad"]) == 2
    assert len(found["everyday"]) == 4
    assert {"bar" in name for name in found["everyday"]} == {True, False}
    groups = {name.rstrip(".ply")[:-1] + str(int(name[-5]) // 2) for name in found["cad"]}
    assert len(groups) == 1


def test_training_leaves_out_what_the_benchmark_takes(collected):
    listed = read_index(collected, "chair")
    held = heldout_groups(listed, HELDOUT_SHARE)
    taken = {mesh.file for mesh in listed if mesh.group in held}
    config = BenchmarkConfig(seed=SEED, objects=30, categories=("chair",), meshes=collected)
    both = {
        case.shape
        for shapes in ("cad", "everyday")
        for case in synthetic_cases(dataclasses.replace(config, shapes=shapes))
    }
    assert both == taken


def test_a_typical_size_is_not_the_real_things(collected):
    index = collected / "index.json"
    entries = json.loads(index.read_text())["meshes"]
    index.write_text(json.dumps({"meshes": [{**entry, "size_typical": True} for entry in entries]}))
    config = BenchmarkConfig(seed=SEED, objects=2, categories=("chair",), meshes=collected, shapes="cad")
    meshes = [case.mesh for case in synthetic_cases(config)]
    assert all(mesh is not None and mesh.diagonal_m is None for mesh in meshes)


def test_an_own_size_is_kept(collected):
    config = BenchmarkConfig(
        seed=SEED, objects=1, categories=("chair",), meshes=collected, shapes="cad", difficulty="hard"
    )
    truth = synthetic_cases(config)[0].scan().ground_truth[1]
    assert np.linalg.norm(np.ptp(p_world(truth), axis=0)[2]) == pytest.approx(0.95, abs=0.15)


def test_sets_of_shapes_need_a_folder(collected):
    with pytest.raises(DatasetError, match="--meshes"):
        synthetic_cases(BenchmarkConfig(shapes="cad"))
    with pytest.raises(DatasetError, match="are no families: say which"):
        synthetic_cases(BenchmarkConfig(meshes=collected))
    entries = json.loads((collected / "index.json").read_text())
    (collected / "index.json").write_text("[]")
    with pytest.raises(DatasetError, match=r"index\.json"):
        synthetic_cases(BenchmarkConfig(meshes=collected, shapes="cad"))
    for entry in entries["meshes"]:
        entry["made_by"] = "people"
    (collected / "index.json").write_text(json.dumps(entries))
    with pytest.raises(DatasetError, match="of the set 'everyday'"):
        synthetic_cases(BenchmarkConfig(meshes=collected, categories=("chair",), shapes="everyday"))
