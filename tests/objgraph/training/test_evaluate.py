"""`objgraph evaluate-prior`: known answers, failures that count, and what it writes."""

import json
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import trimesh
from rich.console import Console

from objgraph.cli.main import main
from objgraph.errors import EvaluationError, PriorError
from objgraph.training.codes.partial import PartialConfig
from objgraph.training.codes.search import SearchConfig
from objgraph.training.meshes.folder import choose_meshes, write_json
from objgraph.training.meshes.samples import SampleConfig
from objgraph.training.quality.evaluate import PriorEvaluationConfig, ShapeRow, evaluate_mesh, evaluate_meshes
from objgraph.training.quality.random_codes import BOX_TOLERANCE, check_random_codes
from objgraph.training.quality.report import document, summary, table
from objgraph.training.quality.true_shape import TrueShape, read_solid
from tests.shapes import MEAN_HALF, box_prior

QUICK = PriorEvaluationConfig(
    resolution=64,
    samples=SampleConfig(count=1000),
    search=SearchConfig(first_points=200, iterations=12),
    partial=PartialConfig(surface_points=300, free_points=400),
)


@pytest.fixture
def folder(tmp_path):
    """Two boxes in their own units, one of them with vertices repeated, a sheet of text, and nothing else."""
    meshes = tmp_path / "meshes"
    (meshes / "deeper").mkdir(parents=True)
    box = trimesh.creation.box((5.0, 7.0, 5.0))
    box.apply_translation([30, -4, 2])
    box.export(meshes / "box.ply")
    trimesh.creation.box((0.4, 0.6, 0.5)).export(meshes / "deeper" / "soup.stl")
    (meshes / "broken.obj").write_text("no mesh at all\n")
    (meshes / "notes.txt").write_text("not a mesh\n")
    return meshes


@pytest.fixture
def rows(folder):
    prior = box_prior()
    return evaluate_meshes(prior, choose_meshes([folder], "chair", prior), QUICK)


def test_boxes_come_out_and_the_broken_file_is_a_failure(rows):
    assert [row.mesh for row in rows] == ["box.ply", "broken.obj", "deeper/soup.stl"]
    for row in (rows[0], rows[2]):
        assert row.error is None
        assert row.chamfer < 0.006
        assert 0.002 < row.chamfer_points < 0.012
        assert row.iou > 0.93
        assert row.recall == row.precision == 1.0
        assert row.chamfer_partial < 0.012
        assert row.partial_ratio == pytest.approx(row.chamfer_partial / row.chamfer)
    failure = rows[1]
    assert "broken.obj" in failure.error
    assert (failure.chamfer, failure.chamfer_partial, failure.iou, failure.recall) == (None, None, 0.0, 0.0)


def test_failures_count_in_the_medians(rows):
    found = summary(rows)
    assert (found["n"], found["failed"]) == (3, 1)
    assert found["median_chamfer"] == max(rows[0].chamfer, rows[2].chamfer)
    assert found["median_iou"] == min(rows[0].iou, rows[2].iou)
    worse = summary([*rows, ShapeRow("x", error="e"), ShapeRow("y", error="e")])
    assert worse["median_chamfer"] is None
    assert worse["ratio_of_medians"] is None
    assert worse["median_iou"] == worse["median_recall"] == 0.0
    assert table(rows, "title").row_count == 3


def test_a_partial_fit_that_fails_leaves_the_full_one(folder, monkeypatch):
    def refuse(*_):
        raise PriorError("nothing of it is seen")

    monkeypatch.setattr("objgraph.training.quality.evaluate.take_view", refuse)
    prior = box_prior()
    row = evaluate_meshes(prior, choose_meshes([folder], "chair", prior), QUICK)[0]
    assert row.chamfer is not None
    assert row.chamfer_partial is None
    assert row.error == "from one view: nothing of it is seen"
    assert summary([row])["median_chamfer_partial"] is None
    assert summary([row])["failed"] == 1


def test_any_error_of_a_mesh_is_that_meshs_failure(folder, monkeypatch):
    def break_down(*_, **__):
        raise ZeroDivisionError("halves of nothing")

    monkeypatch.setattr("objgraph.training.quality.evaluate.full_code", break_down)
    prior = box_prior()
    rows = evaluate_meshes(prior, choose_meshes([folder], "chair", prior), QUICK)
    assert rows[0].error == "ZeroDivisionError: halves of nothing"
    assert len(rows) == 3


def test_of_what_is_flat_no_prior_of_one_box_knows_anything(tmp_path):
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False).export(tmp_path / "flat.ply")
    prior = replace(box_prior(), box=np.array([0.6, 0.6, 0.5]))
    row = evaluate_mesh(prior, tmp_path / "flat.ply", "flat", PriorEvaluationConfig(resolution=32))
    assert row.chamfer is None
    assert row.error == "the shape is flat: no box can be filled by it"


def test_the_document_has_its_keys_and_is_json(folder, rows, tmp_path):
    prior = box_prior()
    found = document(
        prior,
        "box.safetensors",
        choose_meshes([folder], "chair", prior),
        rows,
        QUICK,
        check_random_codes(prior, 20),
    )
    path = tmp_path / "new" / "found.json"
    write_json(found, path)
    read = json.loads(path.read_text())
    assert {
        "n", "failed", "median_chamfer", "median_iou", "median_recall", "median_chamfer_partial",
        "median_partial_ratio", "category", "prior", "settings", "seed", "rows", "random_codes",
    } <= set(read)  # fmt: skip
    assert read["prior"] == {"file": "box.safetensors", "sha256": "box"}
    assert read["random_codes"]["count"] == 20
    assert (read["one_piece"], read["fills_box"]) == (1.0, None)
    assert [row["mesh"] for row in read["rows"]] == ["box.ply", "broken.obj", "deeper/soup.stl"]
    assert read["rows"][1]["chamfer"] is None
    assert list(path.parent.iterdir()) == [path]


def test_the_score_of_the_true_surface_is_perfect_and_a_shifts_is_known(tmp_path):
    trimesh.creation.icosphere(4).export(tmp_path / "ball.ply")
    truth = TrueShape(read_solid(tmp_path / "ball.ply", "ball"))
    radius = 1 / np.sqrt(12)
    np.testing.assert_allclose(truth.extents, 2 * radius, rtol=1e-3)
    ball = trimesh.creation.icosphere(4, radius)
    same = truth.score(ball)
    assert same.chamfer < 2e-4
    assert 0.002 < same.chamfer_points < 0.005
    assert same.recall == same.precision == 1.0
    larger = truth.score(trimesh.creation.icosphere(4, radius + 0.03))
    assert larger.chamfer == pytest.approx(0.03, rel=0.01)
    assert larger.recall == larger.precision == 0.0


def test_faces_within_other_parts_are_no_surface(tmp_path):
    outer, inner = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((0.5, 0.5, 0.5))
    trimesh.util.concatenate([outer, inner]).export(tmp_path / "nested.ply")
    truth = TrueShape(read_solid(tmp_path / "nested.ply", "nested"))
    half = 0.5 / np.sqrt(3)
    assert np.abs(np.abs(truth.points).max(axis=1) - half).max() < 1e-5
    # a point on the inner box is as far from the surface as the outer box is
    assert truth.distance(np.array([[half / 2, 0, 0]]))[0] == pytest.approx(half / 2, rel=1e-3)


def test_the_grid_knows_inside_from_outside(tmp_path):
    trimesh.creation.box((4, 2, 4)).export(tmp_path / "box.ply")
    truth = TrueShape(read_solid(tmp_path / "box.ply", "box"))
    inside = truth.inside(64, 0.55, np.ones(3))
    assert inside.mean() * 1.1**3 == pytest.approx(4 * 2 * 4 / 6**3, rel=0.06)
    wide = truth.inside(64, 0.55, np.array([1.0, 2.0, 1.0]))
    assert wide.sum() == pytest.approx(inside.sum() / 2, rel=0.06)


def test_random_codes_stay_within_and_are_counted():
    prior = box_prior()
    codes = prior.draw_codes(500, np.random.default_rng(0), within=1.5)
    assert np.abs(codes).max() <= 1.5 * np.sqrt(0.5) + 1e-9
    assert np.abs(codes).max() > 1.4 * np.sqrt(0.5)
    found = check_random_codes(prior, 20)
    assert (found.failed, found.one_piece, found.fills_box) == (0, 1.0, None)
    assert check_random_codes(prior, 20, jobs=2) == found


def test_random_codes_are_held_against_the_box():
    box = np.full(3, 2 * MEAN_HALF)
    prior = replace(box_prior(), code_covariance=0.01 * np.eye(3), box=box)
    edges = 2 * (MEAN_HALF + 0.1 * prior.draw_codes(40, np.random.default_rng(1), within=2.0))
    fills = (np.abs(edges / box - 1) <= BOX_TOLERANCE).all(axis=1)
    assert 0 < fills.mean() < 1
    assert check_random_codes(prior, 40, seed=1, resolution=64).fills_box == pytest.approx(
        fills.mean(), abs=0.05
    )


def test_random_codes_without_a_surface_are_failures():
    # half extents of 0.28 + 0.1 code vanish for the codes about -3
    prior = replace(box_prior(), code_mean=np.full(3, -2.5), code_covariance=np.eye(3))
    half = MEAN_HALF + 0.1 * prior.draw_codes(40, np.random.default_rng(3), within=2.0)
    found = check_random_codes(prior, 40, resolution=32, seed=3)
    # a box thinner than a cell may fall between the nodes
    assert 0 < (half.min(axis=1) <= 0).sum() <= found.failed
    assert found.failed <= (half.min(axis=1) <= 1.1 / 32 / 2).sum() < 40


def test_jobs_give_what_one_process_gives(tmp_path):
    (tmp_path / "a.obj").write_text("no mesh\n")
    prior = box_prior()
    meshes = choose_meshes([tmp_path], "chair", prior)
    assert evaluate_meshes(prior, meshes, QUICK, jobs=2) == evaluate_meshes(prior, meshes, QUICK)


def index(folder, files):
    entries = [
        {
            "file": name, "category": category, "group": name, "licence": "CC0", "attribution": "",
            "source_repo": "s", "size_m": None,
        }
        for name, category in files
    ]  # fmt: skip
    (folder / "index.json").write_text(json.dumps({"meshes": entries}))


def test_an_index_and_the_card_choose(folder):
    index(folder, [("box.ply", "chair"), ("deeper/soup.stl", "chair"), ("broken.obj", "table")])
    plain, trained = box_prior(), box_prior(heldout={"collected": ["box.ply", "elsewhere.ply"]})
    assert choose_meshes([folder], "chair", plain).names == ("box.ply", "deeper/soup.stl")
    held = choose_meshes([folder], "chair", trained)
    assert held.names == ("box.ply",)
    assert "held out" in held.chosen
    assert choose_meshes([folder], "chair", trained, "all").names == ("box.ply", "deeper/soup.stl")
    with pytest.raises(EvaluationError, match="lists no chair that the prior's card names"):
        choose_meshes([folder], "chair", plain, "heldout")
    with pytest.raises(PriorError, match="no mesh of category 'car'"):
        choose_meshes([folder], "car", plain)


def test_several_folders(folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "box.ply").write_bytes((folder / "box.ply").read_bytes())
    index(other, [("box.ply", "chair")])
    index(folder, [("box.ply", "chair"), ("deeper/soup.stl", "table")])
    chosen = choose_meshes([folder, other], "chair", box_prior())
    assert chosen.names == (f"{folder.name}/box.ply", "other/box.ply")
    assert chosen.paths == (folder / "box.ply", other / "box.ply")
    # the other lists no table
    assert choose_meshes([other, folder], "table", box_prior()).paths == (folder / "deeper/soup.stl",)
    with pytest.raises(EvaluationError, match="the same names"):
        choose_meshes([folder, folder], "chair", box_prior())
    with pytest.raises(PriorError, match="no mesh of category 'car'"):
        choose_meshes([folder, other], "car", box_prior())


def test_a_damaged_index_is_not_passed_over(folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "index.json").write_text("{")
    with pytest.raises(PriorError, match=r"other/index\.json is no mesh index"):
        choose_meshes([folder, other], "chair", box_prior())


def test_without_an_index_the_card_still_tells(folder):
    trained = box_prior(heldout={"collected": ["box.ply", "elsewhere.ply"]})
    for choice in ("default", "heldout"):
        chosen = choose_meshes([folder], "chair", trained, choice)
        assert (chosen.names, chosen.chosen) == (("box.ply",), "the chair meshes that training held out")
    assert len(choose_meshes([folder], "chair", trained, "all").names) == 3


@pytest.mark.parametrize("card", [{"collected": [{}]}, {"collected": 5}, "none"])
def test_a_card_of_elsewhere_names_nothing_as_held_out(folder, card):
    chosen = choose_meshes([folder], "chair", replace(box_prior(), card={"heldout": card}))
    assert len(chosen.names) == 3


def test_the_table_has_names_with_brackets_as_they_are():
    names = ("sofas [old]/a.ply", "sofa [/b].ply")
    shown = StringIO()
    Console(width=200, file=shown).print(table([ShapeRow(name) for name in names], "chair: [mine] prior"))
    assert all(words in shown.getvalue() for words in (*names, "chair: [mine] prior"))


def test_a_folder_without_index_cannot_tell_what_is_held_out(folder):
    with pytest.raises(EvaluationError, match=r"no index\.json"):
        choose_meshes([folder], "chair", box_prior(), "heldout")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--meshes", "{}/empty"], "{}/empty holds no mesh"),
        (["--meshes", "{}/absent"], "{}/absent is no folder"),
        (["--meshes", "{}", "--heldout", "--all"], "exclude each other"),
        (["--meshes", "{}", "--jobs", "0"], "--jobs must be at least 1"),
        (["--meshes", "{}", "--resolution", "0"], "resolution must be at least 1"),
        (["--meshes", "{}", "--seed", "-1"], "seed must be at least 0"),
        (["--meshes", "{}", "--prior", "{}/absent.safetensors"], "absent.safetensors"),
    ],
)
def test_what_cannot_be_evaluated_is_one_line_and_no_file(arguments, message, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    given = [argument.replace("{}", str(tmp_path)) for argument in arguments]
    out = tmp_path / "found.json"
    status = main(["evaluate-prior", "--category", "chair", "--json", str(out), *given])
    printed = capsys.readouterr().err
    assert status == 1
    assert message.replace("{}", str(tmp_path)) in printed
    assert printed.count("\n") == 1
    assert not out.exists()


def test_no_folder_of_meshes_is_said_so():
    with pytest.raises(EvaluationError, match="no folder of meshes is given"):
        choose_meshes([], "chair", box_prior())


def test_when_every_mesh_fails_it_is_written_so(tmp_path):
    (tmp_path / "bad.obj").write_text("no mesh at all\n")
    out = tmp_path / "found.json"
    assert main(["evaluate-prior", "--category", "bed", "--meshes", str(tmp_path), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert (found["n"], found["failed"]) == (1, 1)
    assert "first_guess" not in found


def test_a_first_guess_that_cannot_be_measured_costs_no_fit(tmp_path, monkeypatch, caplog):
    def fitted(prior, meshes, *_):
        return [ShapeRow(name, chamfer=0.01) for name in meshes.names]

    def break_down(*_, **__):
        raise ZeroDivisionError("halves of nothing")

    (tmp_path / "a.obj").write_text("a mesh\n")
    monkeypatch.setattr("objgraph.cli.evaluate_prior.evaluate_meshes", fitted)
    monkeypatch.setattr("objgraph.cli.evaluate_prior.guess_quality", break_down)
    out = tmp_path / "found.json"
    assert main(["evaluate-prior", "--category", "bed", "--meshes", str(tmp_path), "--json", str(out)]) == 0
    assert json.loads(out.read_text())["median_chamfer"] == 0.01
    assert "the first guess is not measured: halves of nothing" in caplog.text
