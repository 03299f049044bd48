"""What chosen views are worth: the study as its user would run it, on one object."""

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from objgraph.bench.places import spread_out
from tests.conftest import REPOSITORY


@given(st.integers(0, 10**6))
def test_views_that_are_spread_out_are_nearly_as_far_apart_as_any(seed):
    """Half as far as the best choice at least (Ravi et al., "Heuristic and special case algorithms for dispersion problems", 1994)."""
    rng = np.random.default_rng(seed)
    for count in (2, 3, 4):
        turn = rng.uniform(0, np.pi, 12)
        place = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        apart = np.linalg.norm(place[:, None] - place, axis=2)
        chosen = spread_out(apart, count)
        assert chosen[0] == 0
        assert len(set(chosen)) == count
        best = max(least(apart, (0, *rest)) for rest in itertools.combinations(range(1, 12), count - 1))
        assert 0.5 * best <= least(apart, chosen) <= best + 1e-12


def least(apart, chosen) -> float:
    return min(apart[i, j] for i, j in itertools.combinations(chosen, 2))


def test_one_object_is_looked_at_by_all_policies(tmp_path: Path):
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-m", "objgraph.bench.active", "--out", str(out), "--objects", "1", "--most", "2"],
        cwd=tmp_path, capture_output=True, text=True, timeout=900,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    metrics = json.loads((out / "metrics.json").read_text())
    assert (metrics["objects"], metrics["views_next_best"], metrics["objects_failed"]) == (1, 4, 0)
    assert -1 <= metrics["gain_correlation"] <= 1
    for measure in ("", "_box"):
        needed = {policy: metrics[f"views_{policy}{measure}"] for policy in ("random", "even")}
        assert all(1 <= count <= 2 for count in needed.values())
        assert set(metrics[f"reached{measure}"]) == set(needed)
    assert set(metrics["curves"]["chamfer_m"]["next_best"]) == {"1", "2", "3", "4"}
    for name in ("information.png", "active_vision.png"):
        assert (out / name).stat().st_size > 10_000
