"""`objgraph calibrate`: from rows of a comparison to a file that maps take; and what calibrations make of rows."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from objgraph.bench.comparison.objects.calibration import ALL, calibration
from objgraph.bench.comparison.objects.judged import graph_rows, judged
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.objects.tables import calibration_tables
from objgraph.cli.main import main
from objgraph.trust.calibration import Calibration, load_calibration, shipped_calibration
from tests.objgraph.trust.calibrations import objects


def rows(count: int = 160, **changes) -> list[ObjectRow]:
    """Of made-up objects, as `objgraph evaluate` writes them."""
    made = []
    for i, each in enumerate(objects(count)):
        sigma = np.full(50, 0.01)
        errors = np.abs(np.random.default_rng(i).normal(size=50)) * 0.01 * np.sqrt(each.surface["95"])
        made.append(
            ObjectRow(
                "graph", "made up", f"{each.category}-{i}", each.category, each.shape, 3, "settings", [0], start="own", seed=7,
                prior=f"{each.category} weights", pose_correct=each.pose_right, chamfer_m=0.01 if each.shape_right else 0.06,
                well_reconstructed=each.pose_right, heading_error_deg=3.0, surface_error=errors.tolist(),
                surface_sigma=sigma.tolist(), surface_residual=0.0, box_error=each.modes[0][1].tolist(),
                box_covariance=each.marginals.tolist(), box_extents=each.extents.tolist(), box_seen=each.seen_sides.tolist(),
                box_modes=[[p, *error] for p, error in each.modes], evidence=each.evidence.to_json(),
            )
        )  # fmt: skip
    return [replace(row, **changes) for row in made]


def written(folder: Path, made: list[ObjectRow]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "objects.jsonl").write_text("".join(json.dumps(asdict(row)) + "\n" for row in made))
    return folder


def test_rows_become_a_calibration(tmp_path, capsys):
    run, out = written(tmp_path / "run", rows()), tmp_path / "c.json"
    assert main(["calibrate", str(run), "--out", str(out)]) == 0
    known = load_calibration(out)
    assert {name: each.objects for name, each in known.categories.items()} == {"chair": 80, "table": 80}
    assert known.categories["chair"].prior == "chair weights"
    assert known.made["seeds"] == [7]
    assert [entry["of"] for entry in known.made["held_out"]] == ["all", "chair", "table", "made up 3 views"]
    printed = capsys.readouterr().out
    assert "Objects held out" in printed
    assert "objgraph map --calibration" in printed


def test_what_an_earlier_calibration_knows_of_other_categories_stays(tmp_path):
    """And what it knows of those of the runs does not."""
    earlier, out = tmp_path / "earlier.json", tmp_path / "c.json"
    assert main(["calibrate", str(written(tmp_path / "run", rows())), "--out", str(earlier)]) == 0
    chairs = [row for row in rows(200, prior="new weights", seed=8) if row.category == "chair"]
    run = written(tmp_path / "chairs", chairs)
    assert main(["calibrate", str(run), "--keep", str(earlier), "--out", str(out)]) == 0
    before, known = load_calibration(earlier), load_calibration(out)
    assert known.categories["table"] == before.categories["table"]
    assert (known.categories["chair"].prior, known.categories["chair"].objects) == ("new weights", 100)
    assert known.made["kept"] == [{"categories": ["table"], "made": before.made}]
    assert known.made["seeds"] == [8]


def test_of_what_an_earlier_calibration_kept_it_says_how_each_was_made(tmp_path):
    """And of fits of which nothing is left it says nothing."""
    any_of = shipped_calibration().categories["chair"]
    both = Calibration({"chair": any_of, "table": any_of}, {"seeds": [7]})
    chairs = Calibration({"chair": any_of}, {"seeds": [8]})
    tables = Calibration({"table": any_of}, {"seeds": [9]})
    sofas = Calibration({"sofa": any_of}, {"seeds": [10]})
    second = chairs.beside(both)
    assert second.made["kept"] == [{"categories": ["table"], "made": both.made}]
    assert tables.beside(second).made["kept"] == [{"categories": ["chair"], "made": {"seeds": [8]}}]
    assert sofas.beside(second).made == {
        "seeds": [10],
        "kept": [
            {"categories": ["chair"], "made": {"seeds": [8]}},
            {"categories": ["table"], "made": both.made},
        ],
    }


def test_what_objects_are_judged_by_is_what_the_rows_say(tmp_path):
    (row,) = rows(1)
    (each,) = judged(graph_rows(written(tmp_path, [row])))
    (made,) = objects(1)
    assert each.evidence == made.evidence
    assert (each.pose_right, each.shape_right) == (made.pose_right, made.shape_right)
    np.testing.assert_allclose(each.modes[1][1], made.modes[1][1])
    squared = np.square(np.array(row.surface_error) / 0.01)
    assert each.surface["50"] == pytest.approx(np.median(squared) / 0.4549, rel=1e-3)


def test_the_last_row_of_an_object_counts_and_failures_do_not(tmp_path):
    (row,) = rows(1)
    made = [
        replace(row, seed=1),
        row,
        replace(row, case="other", failure="lost"),
        replace(row, start="shared", case="a"),
    ]
    assert graph_rows(written(tmp_path, made)) == [row]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": "shared"}, "no rows of the graph from its own start"),
        ({"method": "ours"}, "no rows of the graph from its own start"),
        ({"failure": "lost"}, "no rows of the graph from its own start"),
        ({"evidence": None}, "rows of an earlier program"),
        ({"pose_correct": True}, "no category has enough objects"),
    ],
)
def test_rows_that_cannot_be_used_are_told(tmp_path, capsys, changes, message):
    run = written(tmp_path / "run", rows(60, **changes))
    assert main(["calibrate", str(run), "--out", str(tmp_path / "c.json")]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "c.json").exists()


def test_a_seed_that_is_none_is_told_before_the_fit(tmp_path, capsys):
    run = written(tmp_path / "run", rows())
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", str(run), "--out", str(tmp_path / "c.json"), "--seed", "-1"])
    assert ended.value.code == 2
    assert "seed must be at least 0" in " ".join(capsys.readouterr().err.split())


def test_folders_and_priors_that_do_not_fit_are_told(tmp_path, capsys):
    one = written(tmp_path / "one", rows(60))
    other = written(tmp_path / "other", rows(60, prior="other"))
    for words, message in (
        ([str(tmp_path)], "no such file"),
        ([str(one), str(other)], "of several priors"),
        ([], "name a folder"),
        ([str(one), "--keep", str(one / "objects.jsonl")], "no calibration of this version"),
    ):
        assert main(["calibrate", *words, "--out", str(tmp_path / "c.json")]) == 1
        assert message in capsys.readouterr().err


def test_reports_say_what_a_calibration_makes_of_rows(tmp_path):
    run, out = written(tmp_path / "run", rows()), tmp_path / "c.json"
    assert main(["calibrate", str(run), "--out", str(out)]) == 0
    fresh, known = rows(400)[160:], load_calibration(out)
    entry, *_ = calibration(fresh, ["graph@own"], known=known)
    assert entry["category"] == ALL
    assert entry["coverage95"] < 0.3  # by the marginals
    assert entry["coverage95_calibrated"] == pytest.approx(0.95, abs=0.05)
    assert entry["coverage50_calibrated"] == pytest.approx(0.5, abs=0.1)
    assert entry["verdict_brier"] < 0.8 * entry["verdict_brier_base"]
    assert entry["wrong_modes_outside"] == 0.0
    assert entry["set_size"] > 0
    titles = [table.title for table in calibration_tables([entry], "made up")]
    assert titles[0] == "Calibrated (made up)"
    lost = [replace(row, failure="lost", evidence=None, box_modes=None) for row in fresh[:40]]
    half, *_ = calibration([*lost, *fresh[40:]], ["graph@own"], known=known)
    assert (half["n"], half["n_failed"], half["n_judged"]) == (240, 40, 200)
    # from another start there was no choice of headings
    other, *_ = calibration([replace(row, start="shared") for row in fresh], ["graph"], known=known)
    assert "verdict_brier" not in other
    # of priors that it does not know it says nothing
    entry, *_ = calibration([replace(row, prior="other") for row in fresh], ["graph@own"], known=known)
    assert "verdict_brier" not in entry
