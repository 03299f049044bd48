"""The suite: commands that can be typed, and a page made of what they left."""

import dataclasses
import json
import shlex
from pathlib import Path

import pytest
from rich.console import Console

from objgraph.bench.comparison.contenders.methods import method
from objgraph.bench.comparison.objects.rows import method_and_start
from objgraph.bench.comparison.objects.summary import paired, summarize
from objgraph.bench.comparison.objects.tables import all_tables
from objgraph.bench.comparison.writing.against import against
from objgraph.bench.comparison.writing.behind import behind_table
from objgraph.bench.comparison.writing.glance import glance_tables
from objgraph.cli.evaluate import run_evaluate
from objgraph.cli.evaluate_command import FIGURES, EvaluateCommand
from objgraph.cli.main import _parsed
from objgraph.cli.suite import _command, line_of, run_suite
from objgraph.cli.suite_page import render
from objgraph.cli.suite_parts import parts
from objgraph.errors import EvaluationError
from tests.objgraph.bench.test_comparison_report import made_up


def document(**changes) -> dict:
    rows, methods = made_up(), ("graph", "ours")
    entries, pairs = summarize(rows, methods), paired(rows, methods)
    return {
        "command": "objgraph evaluate --made-up", "seed": 5, "rows_made_by": ["1.0"], "priors": {"chair": "0123456789abcdef"},
        "rows": entries, "paired": pairs, "tables": [dataclasses.asdict(t) for t in all_tables(entries, pairs, methods, "x")],
        **changes,
    }  # fmt: skip


def put(folder: Path, name: str, content: dict) -> None:
    (folder / name).mkdir(parents=True)
    (folder / name / FIGURES).write_text(json.dumps(content))


@pytest.mark.parametrize("suite", ["docs", "quick"])
def test_every_part_is_a_command_that_can_be_typed(suite):
    names = [part.name for part in parts(suite)]
    assert len(set(names)) == len(names)
    given = EvaluateCommand(out=Path("out"), root=Path("DATA"), seed=3, suite=suite)
    for part in parts(suite):
        words = shlex.split(line_of(part, given))
        command = _parsed(EvaluateCommand, "evaluate", words[2:])
        assert command.seed == 3
        for name, value in part.options.items():
            typed = getattr(command, name)
            assert typed == (Path("DATA") / value if isinstance(value, Path) else value), name
        for word in ",".join(command.methods).split(","):
            assert method(method_and_start(word)[0])


def test_no_more_objects_than_asked_for():
    asked = EvaluateCommand(out=Path("out"), suite="quick", objects=2)
    counts = {part.name: line_of(part, asked) for part in parts("quick")}
    assert "--objects 2" in counts["hard-families"]
    assert "--objects 1" in counts["ours"]
    assert "--objects" not in counts["kitti-1"]
    assert [_command(part, asked).objects for part in parts("quick")][:3] == [2, 2, 1]


def test_parts_run_in_their_folders_and_what_has_no_data_is_left_out(tmp_path, capsys):
    (tmp_path / "data" / "cad2").mkdir(parents=True)
    ran = []

    def run(command, console, line):
        ran.append(command)
        put(command.out.parent, command.out.name, document())

    command = EvaluateCommand(out=tmp_path / "out", root=tmp_path / "data", seed=3, suite="quick", jobs=2)
    run_suite(command, Console(), run)
    assert [each.out.name for each in ran] == ["hard-families", "hard-everyday", "ours"]
    assert all(each.suite is None and each.seed == 3 and each.jobs == 2 for each in ran)
    assert ran[1].meshes == tmp_path / "data" / "cad2"
    assert "kitti-1: left out" in capsys.readouterr().out
    page = (tmp_path / "out" / "results.md").read_text()
    assert page.count("not run.") == len(parts("quick")) - 3


def test_what_is_kept_names_no_place_of_one_machine(tmp_path):
    put(
        tmp_path,
        "hard-families",
        document()
        | {"data": {"meshes": str(tmp_path / "cad2"), "seed": 5}}
        | {"settings": {"graph": {"data": {"root": str(tmp_path / "kitti")}}}},
    )
    render("docs", tmp_path, tmp_path / "docs")
    kept = (tmp_path / "docs" / "results" / "hard-families.json").read_text()
    assert json.loads(kept)["data"] == {"meshes": "cad2", "seed": 5}
    assert json.loads(kept)["settings"] == {"graph": {"data": {"root": "kitti"}}}
    assert str(tmp_path) not in kept


def part_page(docs: Path, name: str) -> str:
    return (docs / "results" / f"{name}.md").read_text()


def test_pages_are_made_of_the_json_alone(tmp_path):
    put(tmp_path, "hard-families", document())
    (tmp_path / "hard-families" / "pose_over_faults.png").write_bytes(b"a picture")
    page = render("docs", tmp_path, tmp_path / "docs").read_text()
    assert "- [Hard: the benchmark's own families](results/hard-families.md)." in page
    assert "### " not in page
    page = part_page(tmp_path / "docs", "hard-families")
    assert page.startswith("# Hard: the benchmark's own families\n")
    assert "objgraph evaluate --made-up" in page
    assert (
        "Seed 5, rows by 1.0; priors: chair `0123456789ab`. Those of chair that ship now are others." in page
    )
    assert "`0123456789ab`" in page
    assert "## Rates with their intervals (x)" in page
    assert "## Paired differences" not in page
    assert "(../images/results_hard-families_pose_over_faults.png)" in page
    assert (tmp_path / "docs/images/results_hard-families_pose_over_faults.png").read_bytes() == b"a picture"
    before = page
    changed = document()
    changed["tables"][2]["sections"][0][0][4]["text"] = "0.123 [0.00, 0.50]"
    (tmp_path / "hard-families" / FIGURES).write_text(json.dumps(changed))
    render("docs", tmp_path, tmp_path / "docs")
    assert "0.123 [0.00, 0.50]" in part_page(tmp_path / "docs", "hard-families")
    assert "0.123 [0.00, 0.50]" not in before


def test_parts_of_a_page_can_be_made_one_by_one(tmp_path):
    """The page's folder keeps what was made elsewhere."""
    put(tmp_path / "first", "hard-families", document())
    (tmp_path / "first/hard-families/pose_over_faults.png").write_bytes(b"a picture")
    put(tmp_path / "second", "icl", document(command="objgraph evaluate --of-icl"))
    render("docs", tmp_path / "first", tmp_path / "docs")
    page = render("docs", tmp_path / "second", tmp_path / "docs").read_text()
    assert "results/hard-families.md" in page
    assert "results/icl.md" in page
    first = part_page(tmp_path / "docs", "hard-families")
    assert "objgraph evaluate --made-up" in first
    assert "results_hard-families_pose_over_faults.png" in first
    assert "objgraph evaluate --of-icl" in part_page(tmp_path / "docs", "icl")
    put(tmp_path / "third", "icl", document(command="objgraph evaluate --again"))
    render("docs", tmp_path / "third", tmp_path / "docs")
    page = part_page(tmp_path / "docs", "icl")
    assert "--again" in page
    assert "--of-icl" not in page


@pytest.mark.parametrize(
    "change",
    [
        {"rows": 3}, {"rows": [3]}, {"rows": [{"contender": "graph", "pose_rate": "x"}]}, {"tables": [{}]}, {"seed": None},
        {"tables": [{"title": "x", "header": [], "sections": [[[3]]], "caption": "", "words": 1}]}, {"rows_made_by": None},
        {"priors": {"chair": 1}}, {"command": []},
    ],
)  # fmt: skip
def test_figures_of_other_values_are_named(tmp_path, change):
    put(tmp_path, "hard-families", document(**change))
    with pytest.raises(EvaluationError, match=r"figures\.json is damaged .* delete it"):
        render("docs", tmp_path, tmp_path / "docs")
    assert not (tmp_path / "docs").exists()


def test_methods_are_set_against_the_graph_from_their_own_start():
    names = ["start", "graph", "ours", "graph@own", "ours@own"]
    assert against(names) == [
        ("graph", "start"),
        ("graph", "ours"),
        ("graph", "graph@own"),
        ("graph@own", "ours@own"),
    ]
    assert against(["start", "graph@own"]) == [("graph@own", "start")]
    assert against(["a", "b", "c"]) == [("a", "b"), ("a", "c")]
    assert against([]) == []


def test_parts_are_chosen_by_name(tmp_path):
    (tmp_path / "data" / "cad2").mkdir(parents=True)
    ran = []

    def run(command, console, line):
        ran.append(command.out.name)
        assert not command.parts
        put(command.out.parent, command.out.name, document())

    command = EvaluateCommand(
        out=tmp_path / "out", root=tmp_path / "data", suite="quick", parts=("ours,hard-everyday",)
    )
    run_suite(command, Console(), run)
    assert ran == ["hard-everyday", "ours"]
    with pytest.raises(EvaluationError, match=r"no part mine in the suite 'quick'; there are hard-families"):
        run_suite(dataclasses.replace(command, parts=("mine",)), Console(), run)


def test_where_the_graph_is_behind_is_told_first(tmp_path):
    entry = {"category": "chair", "views": 3, "pose_rate": 0.5, "iou_rate": 0.9, "median_chamfer_m": 0.02}
    rows = [
        {**entry, "contender": "graph"},
        {**entry, "contender": "graph@own", "pose_rate": 0.7},
        {**entry, "contender": "ours@own", "pose_rate": 0.75, "iou_rate": 0.9001},
        {**entry, "contender": "dsp-slam", "pose_rate": 0.6, "median_chamfer_m": 0.031},
        {**entry, "contender": "ours", "category": "table", "pose_rate": 1.0},
    ]
    box = {"quality": "full", "views": 1, "n": 2, "median_box_iou": 0.7, "median_heading_error_deg": 3.0}
    boxes = [{**box, "contender": "graph"}, {**box, "contender": "ours", "median_heading_error_deg": 2.0}]
    others = [{**entry, "contender": "ours"}, {**entry, "contender": "ours-squared", "pose_rate": 0.6}]
    text = behind_table(
        {"Hard": {"rows": rows}, "Real": {"rows": boxes}, "Options": {"rows": others}}
    ).markdown()
    assert "| Hard, chair, 3 views | 9-DoF pose | ours@own | 0.75 | graph@own | 0.7 | - |" in text
    assert "| Hard, chair, 3 views | 9-DoF pose | dsp-slam | 0.6 | graph | 0.5 | - |" in text
    assert text.count("| Hard") == 2  # as printed the others are equal or worse
    assert "| Real, 1 view, full | heading (deg) | ours | 2.0 | graph | 3.0 | 2 |" in text
    assert text.count("| Real") == 1
    assert "Options" not in text  # no graph is compared there
    put(tmp_path, "hard-families", document())
    page = render("docs", tmp_path, tmp_path).read_text()
    assert page.index("Where the graph is behind") < page.index("## Parts")


def test_an_infinite_median_of_the_graph_is_behind():
    """JSON has no infinity: the figure is missing and its interval is there."""
    entry = {"category": "table", "views": 3, "n": 4}
    lost = {"median_chamfer_m": None, "median_chamfer_m_interval": [0.05, None]}
    unknown = {"median_rotation_deg": None, "median_rotation_deg_interval": None}
    rows = [
        {**entry, **lost, **unknown, "contender": "graph"},
        {**entry, "contender": "ours", "median_chamfer_m": 0.05, "median_rotation_deg": 3.0},
        {**entry, **lost, "contender": "node-slam"},
    ]
    text = behind_table({"Hard": {"rows": rows}}).markdown()
    assert "| Hard, table, 3 views | Chamfer (cm) | ours | 5.0 | graph | ∞ | 4 |" in text
    assert text.count("| Hard") == 1
    assert "| Hard" not in behind_table({"Hard": {"rows": [rows[0], rows[2]]}}).markdown()


def test_a_glance_has_each_method_as_its_users_run_it():
    entry = {"category": "chair", "views": 3, "n": 7, "pose_rate": 0.5, "median_chamfer_m": 0.02}
    rows = [
        {**entry, "contender": "graph", "pose_rate": 0.9},
        {**entry, "contender": "graph@own", "pose_rate": 0.7},
        {**entry, "contender": "graph@own", "pose_rate": 0.1, "views": 1},
        {**entry, "contender": "ours", "median_chamfer_m": None},
        {**entry, "contender": "ours", "category": "table"},
    ]
    boxes = [
        {"quality": "full", "views": 1, "n": 2, "median_box_iou": x, "contender": name}
        for name, x in (("graph", 0.7), ("ours", 0.75))
    ]
    objects, of_boxes = glance_tables(
        {"Hard": {"rows": rows}, "Real": {"rows": boxes}, "Options": {"rows": rows[3:]}}
    )
    assert "| Hard, chair | 7 | **0.70, 2.0** | <u>0.50, ∞</u> | - | - | - | - |" in objects.markdown()
    assert objects.markdown().count("| Hard") == 1  # of tables there is no graph
    assert "Options" not in objects.markdown()
    assert "| Real, full | 2 | <u>0.70</u> | **0.75** | - | - | - | - |" in of_boxes.markdown()
    assert objects.caption == ""
    assert "most views" in of_boxes.caption


def gauss_newton(damping: float | None) -> dict:
    """A document of the graph and of a Gauss-Newton of that damping; None as before there was any."""
    config = {"iterations": 20} | ({} if damping is None else {"damping": damping})
    entry = {"category": "chair", "views": 3, "n": 7, "pose_rate": 0.5, "median_chamfer_m": 0.02}
    names = ("graph", "dsp-slam-gn@own", "dsp-slam-gn+iterations", "dsp-slam-gn-released")
    cells = [[{"text": name, "value": None, "rank": 0, "faint": False}] for name in names]
    return {
        **document(command="objgraph evaluate --methods graph,dsp-slam-gn@own"),
        "methods": {"dsp-slam-gn@own": {"estimator": {"class": "GaussNewtonEstimator", "config": config}}},
        "rows": [{**entry, "contender": name, "method": name.partition("@")[0]} for name in names],
        "tables": [{"title": "Rates with", "header": ["Methods"], "sections": [cells], "caption": "", "words": 1}],
    }  # fmt: skip


@pytest.mark.parametrize("damping", [None, 0.0, 1.0])
def test_rows_of_the_undamped_method_are_not_read_as_the_damped_ones(tmp_path, damping):
    """Before it was damped it had the name that the damped one has."""
    put(tmp_path, "hard-families", gauss_newton(damping))
    page = render("docs", tmp_path, tmp_path / "docs").read_text()
    own = part_page(tmp_path / "docs", "hard-families")
    suffix = "" if damping else "-undamped"
    assert f"| dsp-slam-gn{suffix}@own |" in own
    assert f"| dsp-slam-gn{suffix}+iterations |" in own
    assert "| dsp-slam-gn-released |" in own
    assert "--methods graph,dsp-slam-gn@own\n" in own  # as it was typed
    (line,) = (
        each for each in page.splitlines() if each.startswith("| Hard: the benchmark's own families, chair |")
    )
    *_, steady, released, _ = (cell.strip() for cell in line.split("|"))
    assert (steady == "-") == (not damping)
    assert released != "-"
    # what is kept is read once more without another change
    assert render("docs", tmp_path / "none", tmp_path / "docs").read_text() == page


def test_mistakes_are_told(tmp_path):
    with pytest.raises(EvaluationError, match="nothing of the suite"):
        render("docs", tmp_path, tmp_path)
    (tmp_path / "hard-families").mkdir()
    (tmp_path / "hard-families" / FIGURES).write_text("{")
    with pytest.raises(EvaluationError, match=r"figures\.json is damaged"):
        render("docs", tmp_path, tmp_path)
    with pytest.raises(EvaluationError, match="--out"):
        run_evaluate(EvaluateCommand(suite="quick"), Console(), "")
    with pytest.raises(EvaluationError, match="--render is for a --suite"):
        run_evaluate(EvaluateCommand(out=tmp_path, render=tmp_path), Console(), "")
    with pytest.raises(EvaluationError, match="--parts is for a --suite"):
        run_evaluate(EvaluateCommand(out=tmp_path, parts=("icl",)), Console(), "")
    with pytest.raises(EvaluationError, match="--out names a folder"):
        run_evaluate(EvaluateCommand(), Console(), "")
    with pytest.raises(EvaluationError, match="no start 'mine' in graph@mine"):
        run_evaluate(EvaluateCommand(out=tmp_path, methods=("graph@mine",)), Console(), "")
    with pytest.raises(EvaluationError, match="--start takes shared, own"):
        run_evaluate(EvaluateCommand(out=tmp_path, start=("mine",)), Console(), "")
