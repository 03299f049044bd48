"""Objects in a pose graph over several draws: as its user would run it."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from objgraph.bench import slam
from objgraph.datasets import scannet
from objgraph.datasets.trajectory import read_tum
from objgraph.doctor.seen import Subset
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.conftest import REPOSITORY


def run(out: Path) -> str:
    """What it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "objgraph.bench.slam", "--out", str(out), "--frames", "8", "--objects", "1"],
        cwd=out.parent, capture_output=True, text=True, timeout=600,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_a_finished_seed_is_not_run_again(tmp_path: Path):
    assert "adding objects" in run(tmp_path / "out")
    before = (tmp_path / "out" / "metrics.json").read_text()
    metrics = json.loads(before)
    assert metrics["ate_with_objects_m"] < metrics["ate_odometry_m"]
    assert len(read_tum(tmp_path / "out" / "with_objects_0.txt")) == 8
    assert (tmp_path / "out" / "trajectories.png").stat().st_size > 10_000
    assert "adding objects" not in run(tmp_path / "out")
    assert (tmp_path / "out" / "metrics.json").read_text() == before


def test_a_reference_from_depth_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    config = SampleConfig(camera=CameraConfig(frames=24, width=160, height=120))
    scan = scannet.load(generate_sample(tmp_path / "sample", config) / "scannet")
    scan = replace(scan, frames=Subset(scan.frames, range(3), scan.frames.names[:3]))
    arguments = slam.Arguments(tmp_path, reference="depth")

    true, facts = slam.reference(arguments, scan)

    assert facts["pairs"] >= 2
    assert facts["ate_given_m"] < 0.02  # the room's own poses are exact
    slam.write_metrics(arguments, {0: {"coverage_95": 1.0}}, facts)
    monkeypatch.setattr(slam, "dense_reference", lambda *_: pytest.fail("registered again"))
    again, same = slam.reference(arguments, scan)
    np.testing.assert_allclose(again.T_world_camera, true.T_world_camera, atol=1e-12)
    assert same == facts
