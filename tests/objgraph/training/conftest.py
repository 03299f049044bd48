"""A quick training, and meshes to train on."""

import json
from pathlib import Path

import pytest
import trimesh

from factors.decoder import DecoderConfig
from objgraph.training.decoder.train import (
    OptimiserConfig,
    TrainConfig,
)
from objgraph.training.guess.train import TrainGuessConfig


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
