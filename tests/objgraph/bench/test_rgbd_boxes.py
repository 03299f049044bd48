"""Comparison where the ground truth is boxes: rows, what is measured, the report, and the command."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from objgraph.bench.comparison.boxes.rgbd import rgbd_box_report, summarize_boxes
from objgraph.bench.comparison.objects.compare import Comparison, compare
from objgraph.bench.comparison.objects.measure import Job, measure
from objgraph.cli.main import main
from objgraph.datasets.ground_truth import AnnotatedScan, TrueBox
from objgraph.metrics.placed import PlacedMesh
from tests.objgraph.bench.comparison_fakes import FAST, FakeCase, FakeSource, install, row
from tests.objgraph.datasets.dataset_folders import write_seven_scenes

SHAPE_FIELDS = ("volume_iou", "chamfer_m", "recall", "pearson", "spearman", "surface_error", "surface_sigma")


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    install(monkeypatch)


@dataclass(frozen=True)
class BoxedCase(FakeCase):
    """The toy chair, of which only the box is known."""

    quality: str = "full"
    turned: bool = False

    def scan(self) -> AnnotatedScan:
        scan = super().scan()
        placed = PlacedMesh.of_truth(scan.ground_truth[1])
        T = placed.T_world_object.copy()
        T[:3, 3] = placed.centre_world
        if self.turned:
            T[:3, :3] = T[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
        box = TrueBox.of(T, placed.extents, 2 if self.turned else 1, self.quality)
        return replace(scan, ground_truth={1: box})


def measured(case: FakeCase, *methods: str):
    return {each.method: each for each in measure(Job(case, "fake", 2, dict.fromkeys(methods, "s")), FAST)}


def test_boxes_are_measured_as_those_of_shapes_are():
    of_shape, of_box = (measured(case, "near", "far", "bare") for case in (FakeCase(1), BoxedCase(1)))
    for name in of_box:
        box, shape = of_box[name], of_shape[name]
        assert box.failure is None
        assert (box.quality, shape.quality) == ("full", None)
        for figure in (
            "box_iou",
            "translation_m",
            "rotation_deg",
            "heading_error_deg",
            "scale_pct",
            "scale_pct_max",
        ):
            assert getattr(box, figure) == pytest.approx(getattr(shape, figure), abs=1e-9), figure
        assert box.iou_correct == shape.iou_correct
        assert box.pose_correct == shape.pose_correct
        assert [getattr(box, figure) for figure in SHAPE_FIELDS] == [None] * len(SHAPE_FIELDS)
        assert (box.chamfer_correct, box.well_reconstructed) == (False, False)
        # and what is estimated does not depend on what is known
        assert (box.T_world_object, box.start_scale) == (shape.T_world_object, shape.start_scale)
    near = of_box["near"]
    assert near.heading_error_deg == pytest.approx(np.degrees(0.02), abs=0.01)
    assert near.box_error is not None
    assert np.linalg.norm(near.box_error[3:6]) == pytest.approx(near.translation_m, abs=1e-6)
    assert near.box_covariance is not None
    assert of_box["bare"].box_covariance is None


def test_a_half_turn_of_what_is_alike_from_both_sides_is_no_error():
    near, turned = (measured(BoxedCase(1, turned=t), "near")["near"] for t in (False, True))
    assert turned.heading_error_deg == pytest.approx(near.heading_error_deg, abs=1e-6)
    assert turned.box_iou == pytest.approx(near.box_iou, abs=1e-6)


def box_row(method: str, case: str, quality: str | None, iou: float | None, **values):
    errors = {} if iou is None else {
        "translation_m": 1 - iou, "heading_error_deg": 10 * (1 - iou), "scale_pct": 1.0, "scale_pct_max": 2.0, "seconds_cpu": 3.0,
    }  # fmt: skip
    return row(method, case, box_iou=iou, iou_correct=(iou or 0) > 0.25, quality=quality, **errors, **values)


def test_figures_by_quality():
    rows = [box_row("near", f"c{i}", "full", iou) for i, iou in enumerate((0.2, 0.6, 0.8))]
    rows += [box_row("near", "c3", "partial", 0.5), box_row("near", "c4", "partial", None, failure="lost")]
    rows += [box_row("near", "c5", None, None, failure="no frame sees it")]
    full, partial, unknown = summarize_boxes(rows, ["near"])
    assert [(e["quality"], e["n"], e["n_failed"]) for e in (full, partial, unknown)] == [
        ("full", 3, 0), ("partial", 2, 1), ("unknown", 1, 1),
    ]  # fmt: skip
    assert full["iou_rate"] == pytest.approx(2 / 3)
    assert full["median_box_iou"] == 0.6
    assert full["median_translation_m"] == pytest.approx(0.4)
    assert full["median_box_iou_interval"] == [0.2, 0.8]
    assert full["seconds_cpu"] == 3.0
    # a failure has no overlap and is infinitely far
    assert partial["median_box_iou"] == 0.25
    assert partial["median_translation_m"] is None
    assert (unknown["iou_rate"], unknown["seconds_cpu"]) == (0.0, None)


def test_rows_are_kept_and_reported(tmp_path):
    source = FakeSource((BoxedCase(0), BoxedCase(1, quality="partial")))
    comparison = Comparison(source, ("near", "fails"), (1, 2), tmp_path, FAST)
    rows = compare(comparison)
    assert compare(comparison) == rows
    report = rgbd_box_report(comparison, rows)
    document = json.loads(json.dumps(report.document("made so"), allow_nan=False))
    assert [(e["quality"], e["views"], e["contender"]) for e in document["rows"]] == [
        (quality, views, name)
        for quality in ("full", "partial")
        for views in (1, 2)
        for name in ("near", "fails")
    ]
    text = report.markdown("made so")
    assert "Boxes: medians by how well the true ones are known (fake)" in text
    assert f"| full, 1 view | fails | 1 | 1 | 0.00 | 0.00 | {4 * '∞ [∞, ∞] | '}- |" in text
    assert "| chair-1 (chair, partial), 2 views | near |" in text
    assert "Masks are cut out of the depth by the true boxes" in text


def run(tmp_path, *more: str) -> int:
    arguments = ["evaluate", "--dataset", "sevenscenes", "--root", str(tmp_path), "--methods", "near"]
    return main([*arguments, "--views", "1", "--out", str(tmp_path / "out"), *more])


def test_the_command_measures_boxes(tmp_path, capsys):
    write_seven_scenes(tmp_path)
    # the fakes' start needs a frame of theirs: the objects fail, and that is reported
    assert run(tmp_path) == 0
    assert "Boxes: medians" in capsys.readouterr().out
    document = json.loads((tmp_path / "out" / "figures.json").read_text())
    assert [(e["n"], e["n_failed"]) for e in document["rows"]] == [(1, 1)]
    assert run(tmp_path, "--calibration") == 1
    assert "for data sets with true shapes" in " ".join(capsys.readouterr().err.split())
