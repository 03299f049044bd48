"""Every example runs as its user would run it, on the project's own sample."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from objgraph.datasets.trajectory import read_tum
from tests.conftest import REPOSITORY


def maps_every_object(out: Path) -> None:
    objects = json.loads((out / "map.json").read_text())["objects"]
    assert sorted(entry["category"] for entry in objects) == ["chair"] * 4 + ["table"] * 2
    assert all(entry["status"] == "mapped" for entry in objects)
    assert (out / "map.png").stat().st_size > 10_000


def objects_hold_the_cameras(out: Path) -> None:
    metrics = json.loads((out / "metrics.json").read_text())
    assert 0 < metrics["ate_with_objects_m"] < metrics["ate_odometry_m"]
    assert metrics["seeds"][0]["ate_odometry_m"] == metrics["ate_odometry_m"]
    assert (out / "trajectories.png").stat().st_size > 10_000
    assert len(read_tum(out / "with_objects_0.txt")) == 12


def a_map_grows(out: Path) -> None:
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["objects"] == metrics["objects_in_the_room"] == 1
    assert metrics["ate_with_objects_m"] < 1.5 * metrics["ate_odometry_m"]
    assert (out / "map.png").stat().st_size > 10_000
    assert len(read_tum(out / "with_objects.txt")) == 7


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
    run_example(name, tmp_path / "out")
    EXAMPLES[name][1](tmp_path / "out")
    if name == "slam_with_objects":  # its finished seeds are not run again
        before = (tmp_path / "out" / "metrics.json").read_text()
        assert "adding objects" not in run_example(name, tmp_path / "out")
        assert (tmp_path / "out" / "metrics.json").read_text() == before


def test_every_example_is_tested():
    assert {path.stem for path in (REPOSITORY / "examples").glob("*.py")} == set(EXAMPLES)
