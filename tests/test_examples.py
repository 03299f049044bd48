"""Every example runs as its user would run it, on the project's own sample."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from objgraph.datasets.trajectory import absolute_trajectory_error, read_tum
from tests.conftest import REPOSITORY
from tests.test_main_job import criteria


def maps_every_object(out: Path) -> None:
    objects = json.loads((out / "map.json").read_text())["objects"]
    met = criteria(objects)
    assert met["iou"] == met["chamfer"] == len(objects) == 6
    assert met["pose"] >= 5  # a table may stand a quarter turn off
    assert (out / "map.png").stat().st_size > 10_000


def hold_the_cameras(out: Path, suffix: str, frames: int) -> None:
    """The trajectories that were written; errors were 0.11 to 0.28 of odometry's over four draws."""
    truth, odometry, held = (
        read_tum(out / f"{name}{suffix}.txt") for name in ("truth", "odometry", "with_objects")
    )
    assert len(held) == frames
    error = absolute_trajectory_error(held, truth)
    assert 0 < error < 0.5 * absolute_trajectory_error(odometry, truth)
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["ate_with_objects_m"] == pytest.approx(error, rel=1e-3)


def objects_hold_the_cameras(out: Path) -> None:
    hold_the_cameras(out, "_0", 12)
    assert (out / "trajectories.png").stat().st_size > 10_000


def a_map_grows(out: Path) -> None:
    assert json.loads((out / "metrics.json").read_text())["objects"] == 1  # no double of it
    hold_the_cameras(out, "", 7)
    assert (out / "map.png").stat().st_size > 10_000


def the_next_view_is_chosen(out: Path) -> None:
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


def cars_are_mapped(out: Path) -> None:
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["mapped"] == metrics["detected"] == 5
    assert metrics["mean_iou"] > metrics["mean_iou_detections"] + 0.15
    assert (out / "street.png").stat().st_size > 10_000


EXAMPLES: dict[str, tuple[list[str], Callable[[Path], None]]] = {
    "scannet_graph": (["--views", "2"], maps_every_object),
    "kitti_graph": ([], cars_are_mapped),
    "slam_with_objects": (["--frames", "12", "--objects", "1"], objects_hold_the_cameras),
    "active_vision": (["--objects", "1", "--most", "2"], the_next_view_is_chosen),
    "incremental": (["--frames", "7", "--laps", "0.7", "--objects", "1"], a_map_grows),
}


def run_example(name: str, out: Path) -> str:
    """What it printed."""
    run = subprocess.run(
        [sys.executable, str(REPOSITORY / "examples" / f"{name}.py"), "--out", str(out), *EXAMPLES[name][0]],
        cwd=out.parent, capture_output=True, text=True, timeout=600,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-2000:]
    return run.stdout


@pytest.mark.parametrize("name", EXAMPLES)
def test_example(name: str, tmp_path: Path):
    printed = run_example(name, tmp_path / "out")
    EXAMPLES[name][1](tmp_path / "out")
    if name == "slam_with_objects":  # its finished seeds are not run again
        assert "adding objects" in printed
        before = (tmp_path / "out" / "metrics.json").read_text()
        assert "adding objects" not in run_example(name, tmp_path / "out")
        assert (tmp_path / "out" / "metrics.json").read_text() == before


def test_every_example_is_tested():
    assert {path.stem for path in (REPOSITORY / "examples").glob("*.py")} == set(EXAMPLES)
