"""What chosen views are worth: the study as its user would run it, on one object."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.conftest import REPOSITORY


def test_one_object_is_looked_at_by_all_policies(tmp_path: Path):
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-m", "objgraph.bench.active", "--out", str(out), "--objects", "1", "--most", "2"],
        cwd=tmp_path, capture_output=True, text=True, timeout=900,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    metrics = json.loads((out / "metrics.json").read_text())
    assert (metrics["objects"], metrics["views_next_best"]) == (1, 4)
    assert -1 <= metrics["gain_correlation"] <= 1
    for measure in ("", "_box"):
        needed = {policy: metrics[f"views_{policy}{measure}"] for policy in ("random", "even")}
        assert all(1 <= count <= 2 for count in needed.values())
        assert set(metrics[f"reached{measure}"]) == set(needed)
    assert set(metrics["curves"]["chamfer_m"]["next_best"]) == {"1", "2", "3", "4"}
    for name in ("information.png", "active_vision.png"):
        assert (out / name).stat().st_size > 10_000
