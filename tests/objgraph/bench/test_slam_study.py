"""Objects in a pose graph over several draws: as its user would run it."""

import json
import os
import subprocess
import sys
from pathlib import Path

from objgraph.datasets.trajectory import read_tum
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
