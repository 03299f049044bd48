"""Tables, plots and the command: the paper's figures beside ours, and one line for every mistake."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from objgraph.bench.comparison.contenders.methods import METHODS
from objgraph.bench.comparison.objects.plots import (
    binned,
    error_plot,
    faults_plot,
    proportion_interval,
    uncertainty_plot,
)
from objgraph.bench.comparison.objects.scan_cases import ScanSource, read_split
from objgraph.bench.comparison.objects.summary import paired, summarize
from objgraph.bench.comparison.objects.tables import all_tables
from objgraph.bench.comparison.writing import published
from objgraph.bench.comparison.writing.grid import Cell, Grid, ranked_across
from objgraph.bench.comparison.writing.page import page_of
from objgraph.cli import evaluate as evaluate_command
from objgraph.cli.main import main
from objgraph.errors import DatasetError
from tests.browser import open_page
from tests.objgraph.bench.comparison_fakes import FAST, FakeCase, FakeSource, install, row


def made_up(methods=("graph", "ours"), objects=6, views=(1, 2, 3)):
    rng = np.random.default_rng(0)
    rows = []
    for k, method in enumerate(methods):
        for category in ("chair", "table"):
            for i in range(objects):
                for v in views:
                    chamfer = float((0.01 + 0.01 * k) * rng.lognormal(0, 0.3) / np.sqrt(v))
                    sigma = rng.lognormal(-5, 0.7, 60)
                    error = np.abs(rng.normal(size=60) * sigma)
                    values = {
                        "translation_m": chamfer, "rotation_deg": 100 * chamfer, "chamfer_m": chamfer, "seconds": 2.0, "seconds_cpu": 2.0, "start_seconds": 1.5,
                        "pose_correct": True, "iou_correct": True, "chamfer_correct": i != 2, "pearson": 0.7 - 0.1 * k, "pearson_binned": 0.9 - 0.1 * k,
                        "well_reconstructed": i != 2, "surface_sigma": sigma.tolist(), "surface_error": error.tolist(),
                    }  # fmt: skip
                    if method == "ours" and i == 1:
                        values = {"failure": "lost"}
                    rows.append(row(method, f"{category}-{i}", v, category=category, shape=f"s{i}", **values))
    return rows


@pytest.fixture(scope="module")
def tables():
    rows, methods = made_up(), ("graph", "ours")
    return all_tables(summarize(rows, methods), paired(rows, methods), methods, "made up")


def drawn(grid: Grid) -> str:
    console = Console(width=140, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(grid.rich())
    return console.export_text()


def test_table_1_has_the_paper_s_figures_beside_ours(tables):
    for text in (tables[0].markdown(), drawn(tables[0])):
        for rates in published.RATES.values():
            for by_category in rates.values():
                for figures in by_category.values():
                    for figure in figures:
                        assert f"{figure:.3f}" in text
        for label in published.LABELS.values():
            assert re.search(re.escape(label).replace(r"\*", r"\\?\*") + r" \(published, on ScanNet\)", text)
        assert "0.833" in text  # five of six
        assert "Objects here: 6 chair, 6 table" in text.replace("\n", " ")


def test_the_published_figures_are_marked_as_in_the_paper(tables):
    text = tables[0].markdown()
    assert (
        "| 3 | Ours (published, on ScanNet) | 0.226 | <u>0.682</u> | 0.662 | 0.132 | 0.332 | **0.449** |"
        in text
    )
    line = next(line for line in text.splitlines() if line.startswith("| 1 | Ours w/ Samp2D"))
    assert line.endswith("| **0.226** | 0.621 | 0.633 | **0.140** | 0.316 | **0.439** |")
    # ours are marked among themselves
    assert "| 3 | graph | **1.000** | **1.000** | **0.833** |" in text
    assert "| 3 | ours (Ours) | <u>0.833</u> | <u>0.833</u> | <u>0.667</u> |" in text


def test_table_2_has_the_paper_s_figures_and_counts(tables):
    text = tables[1].markdown()
    for figures in published.PEARSON.values():
        for figure in figures.values():
            assert f"{figure:.3f}" in text
    assert "| Chair, 3 views, 10,000 points | **0.700 (5)** | <u>0.600 (4)</u> | - | - |" in text
    assert "| Chair, 3 views, 100 bins | **0.900 (5)** | <u>0.800 (4)</u> | - | - |" in text
    assert "145 chair, 17 table" in text
    assert "Chamfer distance < 0.05 m" in text


def test_the_correlation_stands_beside_what_it_could_be(tables):
    text = tables[3].markdown()
    assert re.search(
        r"\| Chair, 3 views \| graph \| -?[\d.]+ \[-?[\d.]+, [\d.]+\] \| 0.\d\d \[0.\d\d, 0.\d\d\] \|", text
    )


def test_medians_and_differences_have_intervals(tables):
    medians, pairs = tables[4].markdown(), tables[5].markdown()
    assert re.search(r"\| Chair, 3 views \| graph \| 6 \| 0 \| [\d.]+ \[[\d.]+, [\d.]+\]", medians)
    assert re.search(r"\| Chair, 3 views \| ours \| 6 \| 1 \| [\d.]+ \[[\d.]+, ∞\]", medians)
    assert re.search(r"\| Table, 1 view \| graph - ours \| 6 \| -[\d.]+ \[-[\d.]+, -?[\d.]+\]", pairs)
    assert "1 m, 180 degrees and 1 m at most" in pairs


def test_best_and_second_are_marked_as_printed():
    ranks = [
        c.rank
        for c in ranked_across([Cell("", 0.5), Cell(""), Cell("", 0.50001), Cell("", 0.4), Cell("", 0.1)])
    ]
    assert ranks == [1, 0, 1, 2, 0]
    assert [c.rank for c in ranked_across([Cell("", 0.5), Cell("")])] == [0, 0]


def pixels(path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).reshape(-1, 3)


def test_plots_show_every_method(tmp_path):
    rows, methods = made_up(), ("graph", "ours")
    error_plot(summarize(rows, methods), methods, "made up", tmp_path / "a.png")
    assert uncertainty_plot(rows, methods, "made up", tmp_path / "b.png")
    for name in ("a.png", "b.png"):
        colors = {tuple(color) for color in pixels(tmp_path / name)}
        assert {(0, 0x72, 0xB2), (0xD5, 0x5E, 0)} <= colors


def test_plots_bear_what_is_missing(tmp_path):
    rows = [row("graph", "c", 1, failure="lost"), row("graph", "c", 2, failure="lost")]
    error_plot(summarize(rows, ["graph"]), ["graph"], "nothing", tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000
    assert not uncertainty_plot(rows, ["graph"], "nothing", tmp_path / "b.png")
    assert not (tmp_path / "b.png").exists()


def test_bins_hold_equally_many_points():
    sigma = np.arange(1000.0)
    means, errors = binned(sigma[::-1], 2 * sigma[::-1], bins=4)
    np.testing.assert_allclose(means, [124.5, 374.5, 624.5, 874.5])
    np.testing.assert_allclose(errors, 2 * means)
    assert len(binned(sigma[:30], sigma[:30])[0]) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "fly"], f"no method 'fly'; available: {', '.join(METHODS)}"),
        (["--methods", "graph,fly"], "no method 'fly'"),
        (["--methods", ","], "--methods names none"),
        (["--methods", "graph", "graph"], "--methods names graph twice"),
        (
            ["--dataset", "nope"],
            "no data set 'nope'; available: synthetic, kitti, bag, bop, folder, icl",
        ),
        (["--dataset", "scannet"], "data set 'scannet': --root must name its folder"),
        (["--dataset", "scannet", "--root", "{}"], "holds no folder scans/"),
        (["--dataset", "scannet", "--root", "{}", "--split", "{}/absent"], "{}/absent: no list of scans"),
        (["--dataset", "scannet", "--root", "{}", "--split", "x", "--scenes", "y"], "exclude each other"),
        (
            ["--categories", "zebra"],
            "category 'zebra' is not in the synthetic benchmark: it has chair, table",
        ),
        (["--categories", ","], "--categories names none"),
        (["--views", "0,1"], "--views takes numbers from 1 on, as in 1,2,3; not '0'"),
        (["--views", "1,two"], "not 'two'"),
        (["--views", "1", "4"], "a synthetic object has 3 views; --views asks for 4"),
        (["--objects", "0"], "at least one object"),
        (["--meshes", "{}/absent"], "{}/absent/chair: no such folder"),
        (["--jobs", "0"], "--jobs must be at least 1"),
        (["--json", "{}"], "{} cannot be written"),
    ],
)
def test_a_mistake_is_one_line(arguments, message, tmp_path, capsys):
    folder = str(tmp_path)
    given = {
        "--dataset": ["synthetic"],
        "--methods": ["graph"],
        "--json": [f"{folder}/rows.json"],
        "--views": ["1"],
    }
    option = ""
    for word in (argument.replace("{}", folder) for argument in arguments):
        if word.startswith("--"):
            option = word
            given[option] = []
        else:
            given[option].append(word)
    line = [word for option, values in given.items() for word in (option, *values)]
    status = main(["evaluate", *line, "--out", f"{folder}/out"])
    printed = capsys.readouterr()
    assert status == 1
    assert printed.err.startswith("error: ")
    assert message.replace("{}", folder) in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "rows.json").exists()


@pytest.fixture
def command(tmp_path, monkeypatch):
    """The command on three toy chairs."""
    install(monkeypatch)
    source = FakeSource(tuple(FakeCase(i) for i in range(3)))
    monkeypatch.setattr(evaluate_command, "_source", lambda command: source)
    monkeypatch.setattr(evaluate_command, "ComparisonConfig", lambda **values: FAST)
    out = str(tmp_path / "out")
    return ["evaluate", "--dataset", "fake", "--methods", "near,fails", "--views", "1", "2", "--out", out] + [
        "--json", f"{out}/rows.json",
    ]  # fmt: skip


def test_the_command_writes_everything(command, tmp_path, capsys):
    assert main(command) == 0
    printed = capsys.readouterr().out
    out = tmp_path / "out"
    names = {path.name for path in out.iterdir()}
    assert names == {
        "objects.jsonl", "objects.csv", "settings.json", "rows.json", "tables.md", "report.html", "error_against_views.png",
        "error_against_uncertainty.png",
    }  # fmt: skip
    document = json.loads((out / "rows.json").read_text())
    assert document["command"].startswith("objgraph evaluate --dataset fake --methods near,fails")
    assert document["priors"] == {"chair": "toy"}
    assert document["objects"] == {"chair": 3}
    assert document["shapes"] == {"chair": 2}
    assert set(document["methods"]) == {"near", "fails"}
    assert document["version"].startswith("0.")
    assert document["rows_made_by"] == [document["version"]]
    assert "Chamfer distance < 0.05 m" in document["well_reconstructed"]
    keys = {(e["method"], e["category"], e["views"]): e for e in document["rows"]}
    assert set(keys) == {(m, "chair", v) for m in ("near", "fails") for v in (1, 2)}
    near, fails = keys["near", "chair", 2], keys["fails", "chair", 2]
    fields = {"pose_rate", "iou_rate", "chamfer_rate", "pearson", "seconds"}
    fields |= {f"median_{name}" for name in ("translation_m", "rotation_deg", "chamfer_m")}
    assert fields | {f"{name}_interval" for name in fields} <= set(near)
    assert (near["n"], near["n_failed"], near["n_well"], near["pose_rate"]) == (3, 0, 3, 1.0)
    assert (fails["n"], fails["n_failed"], fails["pose_rate"], fails["median_chamfer_m"]) == (3, 3, 0.0, None)
    assert len(document["paired"]) == 2
    assert document["paired"][0]["median_chamfer_m"] < -0.9
    page = (out / "report.html").read_text()
    assert page.count("<table>") == text_tables(out)
    assert page.count("data:image/png;base64,") == len([*out.glob("*.png")]) > 0
    assert "objgraph evaluate --dataset fake" in page
    text = (out / "tables.md").read_text()
    for part in ("0.656", "0.749", "∞ [∞, ∞]", "near", "objgraph evaluate --dataset fake"):
        assert part in text
    for part in ("Table I", "Table II", "Paired differences", "published, on ScanNet"):
        assert part in printed
    rows = (out / "objects.jsonl").read_bytes()
    assert main(command) == 0
    assert (out / "objects.jsonl").read_bytes() == rows
    assert json.loads((out / "rows.json").read_text()) == document


def test_the_command_reports_calibration_of_the_same_rows(command, tmp_path, capsys):
    assert main(command) == 0
    rows = (tmp_path / "out" / "objects.jsonl").read_bytes()
    assert main([*command, "--calibration"]) == 0
    out = tmp_path / "out"
    assert (out / "objects.jsonl").read_bytes() == rows
    document = json.loads((out / "rows.json").read_text())
    found = [(e["method"], e["views"], e["category"], e["n"]) for e in document["rows"]]
    assert found == [("near", v, c, 3) for v in (1, 2) for c in ("all", "chair")]
    fields = {
        "coverage50",
        "coverage90",
        "coverage95",
        "nees_per_dof",
        "pearson_surface",
        "spearman_surface",
        "nll",
    }
    assert fields | {"sharpness", "wrong_modes"} <= set(document["rows"][0])
    assert "nees_per_dof" in document["measured"]
    assert "Calibration of the 9-DoF box" in (out / "calibration.md").read_text()
    assert (out / "reliability.png").stat().st_size > 5_000
    assert "Calibration of the surface" in capsys.readouterr().out


def test_methods_without_covariances_cannot_be_calibrated(command, capsys):
    bare = [word.replace("near,fails", "fails") for word in command]
    assert main([*bare, "--calibration"]) == 1
    assert "none of fails gives a covariance" in capsys.readouterr().err.replace("\n", " ")


def test_two_reports_at_once_are_refused_before_the_work(command, tmp_path, capsys):
    assert main([*command, "--calibration", "--stability"]) == 1
    assert "exclude each other" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_a_stopped_command_says_that_it_can_go_on(command, monkeypatch, capsys):
    def stop(*_args, **_values):
        raise KeyboardInterrupt

    monkeypatch.setattr("objgraph.bench.comparison.objects.measure.measure", stop)
    assert main(command) == 130
    assert capsys.readouterr().err == "stopped; the same command goes on from here\n"


def test_a_split_file_names_scans(tmp_path):
    path = tmp_path / "data_split"
    path.write_text("# validation\nscene0001_00\n\n scene0002_01  # twice below\nscene0002_01\n")
    assert read_split(path) == ("scene0001_00", "scene0002_01")
    path.write_text("\n# none\n")
    with pytest.raises(DatasetError, match="names no scan"):
        read_split(path)


def test_annotated_objects_of_a_scan_are_cases(shared_data):
    root = shared_data / "scannet"
    told = []
    cases = ScanSource("scannet", root, ("chair", "table")).cases(lambda *what: told.append(what))
    assert told == [(1, 1)]
    assert [case.id for case in cases] == [f"scene0470_00/{i}" for i in range(2, 8)]
    assert [case.category for case in cases] == ["chair"] * 4 + ["table", "chair"]
    assert 1 < len({case.shape for case in cases}) < 6  # some share their CAD model
    scan = cases[0].scan()
    assert cases[0].instance.id in scan.ground_truth
    views = cases[0].views(2)
    assert len(set(views)) == 2
    assert cases[0].views(1) == views[:1]
    with pytest.raises(
        DatasetError, match="no annotated object of zebra in 1 scans; annotated are: chair, table"
    ):
        ScanSource("scannet", root, ("zebra",)).cases()


def test_poses_are_drawn_over_what_is_wrong(tmp_path):
    rows = [
        row(
            "graph", f"c{i}", 3, pose_correct=i % 3 > 0, visible=0.2 + 0.03 * i, camera_error_m=0.001 * i,
            mask_iou=0.9 - 0.02 * i, conditions={"visible": [0.2]},
        )
        for i in range(12)
    ]  # fmt: skip
    assert faults_plot(rows, ["graph", "ours"], "made up", tmp_path / "a.png")
    assert (0, 0x72, 0xB2) in {tuple(color) for color in pixels(tmp_path / "a.png")}
    assert not faults_plot([row("graph")], ["graph"], "clean", tmp_path / "b.png")
    assert not (tmp_path / "b.png").exists()
    low, high = proportion_interval(0, 10)
    assert low == 0
    assert high == pytest.approx(0.2775, abs=1e-3)  # Wilson's, by hand: z² / (n + z²)


def test_what_each_method_is_given_stands_beside_its_rates(tables):
    text = tables[2].markdown()
    assert "| Chair, 3 views | graph | floor, upright, filled box, heading modes | 6 | 6 |" in text
    assert re.search(r"\| Table, 1 view \| ours \| - \| 6 \| 6 \| 0\.83 \[0\.\d\d, 1\.00\]", text)


def text_tables(folder) -> int:
    return (folder / "tables.md").read_text().count("\n### ")


def test_a_page_says_what_the_tables_say_and_no_name_gets_out_of_its_cell():
    cells = (Cell("<b>chair</b>"), Cell("0.5 [0.1, 0.9]", 0.5, 1), Cell("-", None, 0, True))
    grid = Grid("One & two", ("Objects", "pose\nrate", "other"), ((cells,),), "a < b")
    page = page_of("x", "about", [grid], [Path("not drawn.png")])
    root = ElementTree.fromstring(re.sub(r"(?s)^.*?(<table>.*</table>).*$", r"\1", page))
    assert ["".join(cell.itertext()) for cell in root.iter("td")] == ["<b>chair</b>", "0.5 [0.1, 0.9]", "-"]
    assert [cell.get("class") for cell in root.iter("td")] == ["words", "best", "faint"]
    assert [button.text for button in root.iter("button")] == ["Objects", "pose\nrate", "other"]
    assert "<p>a &lt; b</p>" in page
    assert "<h2>One &amp; two</h2>" in page
    assert "not drawn" not in page


def test_a_click_sorts_a_column_by_its_numbers(tmp_path):
    texts = ("0.10 [0.1, 0.2]", "-", "∞ [2, ∞]", "0.09")
    rows = tuple((Cell(name), Cell(text)) for name, text in zip("abcd", texts, strict=True))
    path = tmp_path / "page.html"
    path.write_text(page_of("x", "", [Grid("t", ("Objects", "error"), (rows[:2], rows[2:]))], []))
    with open_page(path) as page:
        names = page.locator("tbody td:first-child")
        page.click("th button >> nth=1")
        assert names.all_text_contents() == ["d", "a", "c", "b"]
        page.click("th button >> nth=1")
        assert names.all_text_contents() == ["c", "a", "d", "b"]
        page.click("th button >> nth=0")
        assert names.all_text_contents() == ["a", "b", "c", "d"]
