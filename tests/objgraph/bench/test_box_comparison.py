"""Table III: rows of boxes, what counts, and a run that goes on where it was stopped."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from objgraph.bench.comparison.boxes import compare as box_compare
from objgraph.bench.comparison.boxes.compare import LidarComparison, compare_boxes, estimator_of
from objgraph.bench.comparison.boxes.report import box_report
from objgraph.bench.comparison.boxes.rows import DETECTIONS, BoxRow, counted, paired, summarize
from objgraph.bench.comparison.writing import published
from objgraph.cli.main import main
from objgraph.datasets.kitti import load_frame, load_labels
from objgraph.errors import EvaluationError, SolveError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate
from objgraph.geometry.boxes import box_iou
from objgraph.maps.lidar_task import ROADS
from objgraph.synthetic.street import StreetConfig, ensure_street


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"), StreetConfig(frames=2, cars=2))


def box_row(method: str, number: int, iou: float | None, points: int = 100, **other) -> BoxRow:
    return BoxRow(
        method, "0", number, "digest", label=number, points=points, distance_m=15.0, iou=iou, **other
    )


def test_figures_of_rows():
    rows = [box_row("graph", i, iou) for i, iou in enumerate([0.5, 0.65, 0.8, 0.9])]
    rows.append(box_row("graph", 4, None, failure="no returns"))
    rows.append(box_row("graph", 5, 1.0, points=20))
    (entry,) = summarize(counted(rows, 50), ["graph", "ours"])
    assert entry["n"] == 5
    assert entry["n_failed"] == 1
    assert entry["mean_iou"] == pytest.approx((0.5 + 0.65 + 0.8 + 0.9) / 5)  # the failure counts as 0
    assert (entry["iou60"], entry["iou75"]) == (0.6, 0.4)
    low, high = entry["mean_iou_interval"]
    assert low < entry["mean_iou"] < high
    assert [(part["from"], part["n"]) for part in entry["by_points"]] == [(100, 5)]
    assert [(part["from"], part["to"]) for part in entry["by_distance_m"]] == [(10.0, 20.0)]


def test_differences_are_on_the_same_objects():
    rows = [box_row("a", i, iou) for i, iou in enumerate([0.5, 0.7, 0.9])]
    rows += [box_row("b", i, iou) for i, iou in enumerate([0.4, 0.8])] + [box_row("b", 7, 1.0)]
    (pair,) = paired(rows, ["a", "b"])
    assert (pair["a"], pair["b"], pair["n"]) == ("a", "b", 2)
    assert pair["mean_iou"] == pytest.approx(0.0)
    assert pair["mean_iou_interval"] == pytest.approx([-0.1, 0.1])
    assert paired(rows, ["a"]) == []


def test_detections_without_a_label_do_not_count():
    assert counted([BoxRow("graph", "0", 1, "digest")], 0) == []


def test_graphs_stand_on_roads():
    estimator = estimator_of("graph-det2d")
    assert isinstance(estimator, GraphEstimator)
    assert estimator.graph.floor_spacing == ROADS.floor_spacing
    assert estimator.graph.renderer == "deterministic"
    assert type(estimator_of("ours")).__name__ == "AdamEstimator"


class Slow:
    """Stands in for an estimator: the start is the estimate; counts how often it is asked."""

    calls = 0

    def estimate(self, tasks, progress=None):
        type(self).calls += 1
        if type(self).calls == 3:
            raise KeyboardInterrupt
        return [
            SolveError(f"{task.name}: no") if i == 1 else Estimate(task.starts[0], None, 1.0, 0.5, 1, 1)
            for i, task in enumerate(tasks)
        ]


def test_a_run_goes_on_where_it_was_stopped(street, tmp_path, monkeypatch):
    monkeypatch.setattr(box_compare, "estimator_of", lambda name: Slow())
    monkeypatch.setattr(box_compare, "settings_of", lambda value: str(type(value).__name__))
    comparison = LidarComparison(street, ("graph", "ours"), tmp_path)
    Slow.calls = 0
    with pytest.raises(KeyboardInterrupt):
        compare_boxes(comparison)
    done = (tmp_path / box_compare.ROWS).read_bytes()
    rows = compare_boxes(comparison)
    assert (tmp_path / box_compare.ROWS).read_bytes().startswith(done)
    assert Slow.calls == 5  # four that succeeded, and the one that was stopped
    assert len(rows) == len({row.key for row in rows}) == 12
    again = compare_boxes(comparison)
    assert Slow.calls == 5
    assert {row.key for row in again} == {row.key for row in rows}
    for row in rows:
        assert (row.failure is not None) == (row.method != DETECTIONS and row.detection == 2)
        assert (row.iou is None) == (row.failure is not None)
    with pytest.raises(
        EvaluationError, match=r"'detections' made with other settings.*seed: 0 before, 1 now"
    ):
        compare_boxes(LidarComparison(street, ("graph",), tmp_path, seed=1))


@pytest.mark.parametrize("part", ["velodyne", "label_2"])
def test_a_damaged_frame_fails_alone(street, tmp_path, monkeypatch, part):
    monkeypatch.setattr(box_compare, "estimator_of", lambda name: Slow())
    monkeypatch.setattr(box_compare, "settings_of", lambda value: str(type(value).__name__))
    broken = tmp_path / "street"
    shutil.copytree(street, broken)
    first, second = sorted((broken / "training" / part).iterdir())
    first.write_bytes(first.read_bytes()[:30])
    Slow.calls = 10
    rows = compare_boxes(LidarComparison(broken, ("graph",), tmp_path / "out"))
    assert {row.frame for row in rows if row.iou is not None} == {second.stem}
    damaged = [row for row in rows if row.frame == first.stem]
    assert {row.method for row in damaged} == {DETECTIONS, "graph"}
    assert all(first.name in str(row.failure) and row.points is None for row in damaged)


def test_a_frame_whose_rows_a_kill_has_cut_is_run_again(street, tmp_path, monkeypatch):
    monkeypatch.setattr(box_compare, "estimator_of", lambda name: Slow())
    monkeypatch.setattr(box_compare, "settings_of", lambda value: str(type(value).__name__))
    comparison = LidarComparison(street, ("graph",), tmp_path)
    Slow.calls = 10
    rows = compare_boxes(comparison)
    path = tmp_path / box_compare.ROWS
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]))
    again = compare_boxes(comparison)
    assert Slow.calls == 13  # two frames, and the second once more
    assert {row.key for row in again} == {row.key for row in rows}
    compare_boxes(comparison, retry_failed=True)
    assert Slow.calls == 15  # one failed in each


def test_the_detections_own_row_is_theirs(street, tmp_path):
    rows = compare_boxes(LidarComparison(street, (), tmp_path))
    assert {row.method for row in rows} == {DETECTIONS}
    for row in rows:
        assert row.label is not None
        assert row.error_m is not None
        detection = load_frame(street, row.frame).detection(row.detection)
        label = load_labels(street, row.frame)[row.label - 1]
        assert row.iou == pytest.approx(box_iou(detection.box, label.box))
        assert row.points == label.box.contains(load_frame(street, row.frame).p_world).sum()
        T = label.T_rect_object
        assert np.allclose(row.error_m, T[:3, :3].T @ (detection.box.centre - T[:3, 3]))


def test_a_report_says_how_many_detections_are_left_out(street, tmp_path):
    comparison = LidarComparison(street, (), tmp_path)
    rows = compare_boxes(comparison)
    rows[0] = replace(rows[0], label=None, points=None)
    least = sorted(row.points for row in rows if row.points is not None)[1]
    counts = box_report(comparison, rows, least).document("made so")["detections"]
    assert counts == {"all": len(rows), "of_a_label": len(rows) - 1, "with_the_points": len(rows) - 2}


def test_the_command_writes_table_three(street, tmp_path, capsys):
    figures = tmp_path / "figures.json"
    arguments = ["evaluate", "--dataset", "kitti", "--root", str(street), "--methods", "graph"]
    assert main([*arguments, "--scenes", "000001", "--json", str(figures)]) == 0
    printed = capsys.readouterr().out
    assert "Table III" in printed
    document = json.loads(figures.read_text())
    rows = {row["method"]: row for row in document["rows"]}
    assert set(rows) == {"detections", "graph"}
    for name in ("n", "mean_iou", "iou60", "iou75", "seconds"):
        assert name in rows["graph"]
    assert rows["graph"]["mean_iou"] > rows["detections"]["mean_iou"] + 0.15
    assert rows["graph"]["n"] == rows["detections"]["n"] == document["detections"]["with_the_points"]
    folder = tmp_path / "figures_rows"
    assert {path.name for path in folder.iterdir()} == {
        "boxes.jsonl",
        "settings.json",
        "tables.md",
        "report.html",
        "iou.png",
    }
    assert published.KITTI_WHERE in (folder / "tables.md").read_text()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--methods", "best"], "no method 'best'"),
        (["--scenes", "7"], "no frame '7'"),
        (
            ["--least-points", "1000000", "--methods", "graph", "--scenes", "000000"],
            "no detection is near enough",
        ),
        (["--calibration"], "for data sets with true shapes"),
        (["--stability"], "for data sets with true shapes"),
    ],
)
def test_what_is_wrong_is_one_line(street, tmp_path, capsys, monkeypatch, more, message):
    monkeypatch.setattr(box_compare, "estimator_of", lambda name: Slow())
    monkeypatch.setattr(box_compare, "settings_of", lambda value: str(type(value).__name__))
    Slow.calls = 10
    arguments = [
        "evaluate",
        "--dataset",
        "kitti",
        "--root",
        str(street),
        "--json",
        str(tmp_path / "f.json"),
        *more,
    ]
    assert main(arguments) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "f.json").exists()


def test_a_damaged_frame_is_named(street, tmp_path, capsys):
    root = shutil.copytree(street, tmp_path / "kitti")
    (root / "training" / "velodyne" / "000001.bin").write_bytes(b"")
    arguments = ["evaluate", "--dataset", "kitti", "--root", str(root), "--methods", "graph"]
    assert main([*arguments, "--scenes", "000001", "--json", str(tmp_path / "f.json")]) == 1
    assert "the scan is empty" in " ".join(capsys.readouterr().err.split())


def test_real_cars(shared_data, tmp_path):
    """Three of the real frames, 8 cars: better than the paper's best mean, and far better than the detections."""
    comparison = LidarComparison(shared_data / "kitti", ("graph",), tmp_path, ("000007", "000008", "000004"))
    rows = counted(compare_boxes(comparison), 50)
    entries = {entry["method"]: entry for entry in summarize(rows, comparison.rows_of)}
    assert entries["graph"]["n"] == 8
    assert entries["graph"]["mean_iou"] > 0.74
    assert entries["graph"]["mean_iou"] > entries["detections"]["mean_iou"] + 0.15
    assert entries["graph"]["iou60"] >= 0.9
