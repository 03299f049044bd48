"""Calibration: figures of draws whose covariance is known, and what becomes of failures and wrong modes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from objgraph.bench.comparison.objects.calibration import ALL, FUSED, calibration, holding_levels, with_fused
from objgraph.bench.comparison.objects.plots import reliability_plot
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.objects.tables import calibration_tables

N = 1500


def rows_of(
    method: str = "graph",
    factor: float = 1.0,
    count: int = N,
    views: int = 3,
    category: str = "chair",
    seed: int = 0,
) -> list[ObjectRow]:
    """Objects with Gaussian errors `factor` times as large as their covariances say."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(count):
        root = rng.normal(size=(9, 9)) * 0.02 + 0.02 * np.eye(9)
        sigma = rng.uniform(0.01, 0.03, 40)
        residual = 0.008
        rows.append(
            ObjectRow(
                method, "made up", f"{category}-{i}", category, f"shape-{i}", views, "", [],
                well_reconstructed=True, pearson=0.5, spearman=0.4,
                box_error=(factor * root @ rng.normal(size=9)).tolist(), box_covariance=(root @ root.T).tolist(),
                heading_error_deg=3.0, surface_sigma=sigma.tolist(), surface_residual=residual,
                surface_error=np.abs(factor * np.hypot(sigma, residual) * rng.normal(size=40)).tolist(),
            )
        )  # fmt: skip
    return rows


def test_covariances_that_hold_are_found_to_hold():
    (entry, _) = calibration(rows_of(), ["graph"])
    assert (entry["category"], entry["n"], entry["wrong_modes"]) == (ALL, N, 0.0)
    for level in (50, 90, 95):
        assert entry[f"coverage{level}"] == pytest.approx(level / 100, abs=0.03)
        assert entry[f"surface_coverage{level}"] == pytest.approx(level / 100, abs=0.01)
    low, high = entry["nees_chi2"]
    assert low < entry["nees_per_dof"] < high
    assert entry["nees_per_dof_interval"][0] < 1 < entry["nees_per_dof_interval"][1]
    assert entry["surface_nees"] == pytest.approx(1.0, abs=0.03)
    assert (entry["pearson_surface"], entry["spearman_surface"]) == (0.5, 0.4)


def test_covariances_that_are_too_small_are_found_out_and_less_likely():
    true, small = (calibration(rows_of(factor=factor), ["graph"])[0] for factor in (1.0, 2.0))
    assert small["nees_per_dof"] == pytest.approx(4 * true["nees_per_dof"], rel=1e-9)
    assert small["coverage95"] < 0.4
    assert small["nll"] - true["nll"] == pytest.approx(0.5 * 9 * 3, rel=0.05)
    assert small["surface_nll"] > true["surface_nll"]
    assert small["sharpness"] == true["sharpness"]


def test_likelihood_and_sharpness_by_hand():
    variance = np.linspace(0.01, 0.09, 9)
    error = np.linspace(-0.2, 0.2, 9)
    row = ObjectRow(
        "graph", "made up", "a", "chair", "a", 1, "", [], box_error=error.tolist(),
        box_covariance=np.diag(variance).tolist(), heading_error_deg=0.0,
    )  # fmt: skip
    (entry, chairs) = calibration([row], ["graph"])
    assert entry["nll"] == pytest.approx(-norm.logpdf(error, scale=np.sqrt(variance)).sum())
    assert entry["sharpness"] == pytest.approx(np.exp(np.log(np.sqrt(variance)).mean()))
    assert entry["nees_per_dof"] == pytest.approx((error**2 / variance).mean())
    assert chairs == entry | {"category": "chair"}
    assert entry["nll_interval"] is None
    assert entry["surface_nees"] is None


def test_what_has_no_heading_has_eight_errors():
    """A round object's error about y is zero by definition."""
    errors = np.random.default_rng(1).normal(size=(3000, 9))
    errors[:, 1] = 0.0
    round_ = [
        replace(row, truth_symmetry=0, box_covariance=np.eye(9).tolist(), box_error=error)
        for row, error in zip(rows_of(count=3000), errors.tolist(), strict=True)
    ]
    entry, *_ = calibration(round_, ["graph"])
    assert entry["coverage95"] == pytest.approx(0.95, abs=0.012)
    assert entry["nees_per_dof"] == pytest.approx(1.0, abs=0.03)
    low, high = entry["nees_chi2"]
    assert (low, high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 24_000) / 24_000))


def test_failures_and_wrong_modes_are_not_covered_and_not_in_the_nees():
    good = rows_of(count=6)
    turned = ObjectRow(
        **(vars(good[0]) | {"case": "turned", "heading_error_deg": 90.0, "box_error": [9.0] * 9})
    )
    failed = ObjectRow("graph", "made up", "lost", "chair", "lost", 3, "", [], failure="no surface")
    (entry, _) = calibration([*good, turned, failed], ["graph"])
    alone, _ = calibration(good, ["graph"])
    assert (entry["n"], entry["n_failed"], entry["n_right_mode"]) == (8, 1, 6)
    assert entry["wrong_modes"] == 0.25
    assert entry["nees_per_dof"] == alone["nees_per_dof"]
    assert entry["coverage95"] == pytest.approx(alone["coverage95"] * 6 / 8)
    assert len(holding_levels([*good, turned, failed])) == 6


def test_what_has_no_heading_is_held_by_ellipsoids_of_its_own_dimensions():
    """Levels are even where covariances hold, also of round objects, which have eight degrees of freedom."""
    for symmetry in (1, 0):
        rows = [replace(row, truth_symmetry=symmetry) for row in rows_of()]
        levels = np.sort(holding_levels(rows))
        assert np.abs(levels - (np.arange(N) + 0.5) / N).max() < 0.04


def test_entries_tables_and_plot_have_every_method_and_number_of_views(tmp_path):
    rows = [
        *rows_of("graph", 1.2, 30), *rows_of("graph", 1.0, 20, 1, "table", 1),
        *rows_of("ours", 3.0, 30, seed=2), ObjectRow("dsp-slam", "made up", "x", "chair", "x", 3, "", []),
    ]  # fmt: skip
    entries = calibration(rows, ["graph", "ours", "dsp-slam"])
    found = [(e["method"], e["views"], e["category"], e["n"]) for e in entries]
    assert found == [
        ("graph", 1, ALL, 20), ("graph", 1, "table", 20), ("graph", 3, ALL, 30), ("graph", 3, "chair", 30),
        ("ours", 3, ALL, 30), ("ours", 3, "chair", 30),
    ]  # fmt: skip
    boxes, surfaces = calibration_tables(entries, "made up")
    text = boxes.markdown() + surfaces.markdown()
    assert f"{entries[2]['nees_per_dof']:.2f} [" in text
    assert "All, 1 view |" in text
    assert reliability_plot(rows, ["graph", "ours"], "made up", tmp_path / "r.png")
    assert (tmp_path / "r.png").stat().st_size > 10_000
    assert not reliability_plot(rows, ["dsp-slam"], "made up", tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def placed(row: ObjectRow, method: str, box_error: float, variance: float, yaw: float = 0.0) -> ObjectRow:
    T = np.eye(4)
    T[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    return replace(
        row, method=method, T_world_object=T.tolist(), box_error=[box_error] * 9,
        box_covariance=(variance * np.eye(9)).tolist(),
    )  # fmt: skip


def test_a_fused_box_lies_between_its_parts_and_is_no_surer_than_both():
    (row,) = rows_of(count=1)
    parts = [placed(row, "graph", 0.03, 1e-4), placed(row, "ours", -0.01, 3e-4)]
    rows, methods = with_fused(parts, ["graph", "ours"])
    assert (rows[:2], methods) == (parts, ["graph", "ours", FUSED])
    assert rows[2].method == FUSED
    np.testing.assert_allclose(
        np.array(rows[2].box_covariance, float), 1.5e-4 * np.eye(9), rtol=1e-9, atol=1e-15
    )
    np.testing.assert_allclose(np.array(rows[2].box_error, float), (3 * 0.03 - 0.01) / 4)
    assert [entry["method"] for entry in calibration(rows, methods)] == ["graph"] * 2 + ["ours"] * 2 + [
        FUSED
    ] * 2


def test_of_two_modes_the_graphs_stands():
    (row,) = rows_of(count=1)
    graph = placed(row, "graph", 0.03, 1e-4)
    (_, _, fused), _ = with_fused([graph, placed(row, "ours", -0.01, 3e-4, np.pi / 2)], ["graph", "ours"])
    assert (fused.box_error, fused.box_covariance) == (graph.box_error, graph.box_covariance)
    failed = ObjectRow("ours", "made up", row.case, "chair", row.shape, 3, "", [], failure="lost")
    (_, _, fused), _ = with_fused([graph, failed], ["graph", "ours"])
    assert fused.box_error == graph.box_error
    assert with_fused([graph], ["graph"]) == ([graph], ["graph"])
