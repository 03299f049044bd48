"""Figures of speed: what they are ratios of, that what is timed does its work, and how they are told. No time is judged."""

import json

import numpy as np
import pytest

from objgraph.bench.comparison.contenders.methods import GN_SHORT, GRAPH_ENDED
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.speed import crates, updates
from objgraph.bench.speed.against import figures_of
from objgraph.bench.speed.figure import Figure, in_turns, ratio
from objgraph.bench.speed.floor import over_floor
from objgraph.bench.speed.many import CONFIG, many_objects
from objgraph.bench.speed.updates import growing_map, map_of, solved_crates
from objgraph.bench.speed.whole import _run
from objgraph.cli import bench as bench_command
from objgraph.cli.main import main
from objgraph.errors import EvaluationError
from objgraph.maps.pipeline import map_scan


def test_a_ratio_is_that_of_the_medians_and_its_spread_that_of_the_pairs():
    found = ratio("r", [2.0, 3.0, 10.0], [1.0, 2.0, 2.0], 1.5, "of what")
    assert (found.value, found.low, found.high) == (1.5, 1.5, 5.0)
    assert found.reached
    assert not ratio("r", [2.0], [1.0], 2.5, "", better="more").reached
    assert ratio("r", [2.0], [1.0], None, "").reached is None


def test_what_is_measured_in_turns_is_called_in_turns_and_the_first_round_does_not_count():
    called: list[str] = []
    spent = in_turns({"a": lambda: called.append("a"), "b": lambda: called.append("b")}, 3)
    assert called == ["a", "b"] * 4
    assert {name: len(each) for name, each in spent.items()} == {"a": 3, "b": 3}


def row(
    method: str, case: str, seconds: float, chamfer_m: float | None = 0.02, failure: str | None = None
) -> ObjectRow:
    return ObjectRow(
        method=method, case=case, dataset="synthetic", category="chair", shape="s", settings="", frames=[0], views=3, seconds_cpu=seconds, start_seconds=1.0,
        chamfer_m=chamfer_m, failure=failure,
    )  # fmt: skip


def rows_of(case: str, gn: tuple[float, float], ours: tuple[float, float | None]) -> list[ObjectRow]:
    """The graph's after 1, 2, ... seconds, ever better but for once; the others' with their seconds and Chamfer distances."""
    chamfers = [0.09, 0.03, 0.06, 0.05, 0.04, 0.03, 0.02]
    graph = [
        row(name, case, float(k), chamfer)
        for k, (name, chamfer) in enumerate(zip([*GRAPH_ENDED, "graph"], chamfers, strict=True))
    ]
    return [*graph, row(GN_SHORT, case, *gn), row("ours", case, *ours)]


def test_methods_are_compared_on_objects_that_all_of_them_estimate():
    rows = [*rows_of("a", (2.5, 0.055), (199.0, 0.1)), *rows_of("b", (2.5, 0.055), (199.0, 0.1))]
    rows += [row("graph", "c", 1000.0), row(GN_SHORT, "c", 1.0, failure="lost"), row("ours", "c", 1.0)]
    found = {each.name: each for each in figures_of(rows, "toys")}
    assert found["graph_over_dsp_gn"].value == pytest.approx(7 / 3.5)
    assert found["graph_over_dsp_gn_as_good"].value == pytest.approx(4 / 3.5)  # .03, for once, does not count
    assert found["ours_over_graph"].value == pytest.approx(200.0)  # the first guess is as good
    assert found["ours_over_graph_end"].value == pytest.approx(200 / 7)
    assert not found["graph_over_dsp_gn"].reached
    assert found["ours_over_graph"].reached
    assert "2 objects, toys" in found["graph_over_dsp_gn"].what
    with pytest.raises(EvaluationError, match="no object was estimated by all"):
        figures_of(rows[:2], "toys")


def test_a_graph_that_never_is_as_good_takes_for_ever():
    found = {each.name: each for each in figures_of(rows_of("a", (2.5, 0.01), (199.0, None)), "toys")}
    assert found["graph_over_dsp_gn_as_good"].value == np.inf
    assert not found["graph_over_dsp_gn_as_good"].reached
    assert found["ours_over_graph"].value == pytest.approx(200.0)  # they have no surface at all


def test_a_linearisation_takes_more_than_its_products(tmp_path):
    found = over_floor(tmp_path, 3)
    assert found.name == "linearisation_over_floor"
    assert found.value > 1
    assert " with derivatives" in found.what


def test_crates_are_mapped_to_where_they_stand():
    found = map_scan(crates.scan(3), CONFIG)
    assert len(found.mapped) == 3
    for entry in found.mapped:
        assert entry.vertices is not None
        low, high = entry.vertices.min(axis=0), entry.vertices.max(axis=0)
        true = crates.pose(entry.id - 1).translation()
        np.testing.assert_allclose((low + high) / 2, true, atol=0.08)
        assert high[2] == pytest.approx(crates.extents(entry.id - 1)[1], abs=0.08)


def test_a_large_map_is_measured_and_read_back():
    found = {each.name: each for each in many_objects(2, 4)}
    assert set(found) == {"object_1000_over_10", "many_mb", "save_seconds", "load_seconds"}
    assert "4 of 4 mapped" in found["object_1000_over_10"].what
    assert all(np.isfinite(each.value) for each in found.values())


def test_updates_see_what_the_map_has():
    found = growing_map(10, 20, 4)
    assert found.name == "update_1000_over_10"
    assert found.value > 0
    objects = map_of(10, solved_crates())
    assert len(objects.objects) == 10


def test_updates_that_see_nothing_known_are_no_measurement(monkeypatch):
    monkeypatch.setattr(updates, "updates", lambda objects, repeats: [])
    monkeypatch.setattr(updates, "map_of", lambda count, solved: None)
    with pytest.raises(EvaluationError, match="only 0 of 4 updates"):
        growing_map(10, 20, 4)


def test_a_command_that_fails_is_told_with_what_it_said():
    with pytest.raises(EvaluationError, match="objgraph map --dataset nothing"):
        _run(["map", "--dataset", "nothing", "--out", "x"])


def test_the_command_shows_and_writes_what_was_measured(tmp_path, capsys, monkeypatch):
    parts = {
        "one": lambda: [Figure("demo_seconds", 12.3, 11.0, 14.0, 60.0, "less", "a map")],
        "two": lambda: [ratio("two_cores_over_one", [1.5], [1.0], 1.7, "a room", better="more")],
    }

    def fail() -> list[Figure]:
        raise EvaluationError("there is one core")

    monkeypatch.setattr(bench_command, "_parts", lambda command, folder: {**parts, "cores": fail})
    assert main(["bench"]) == 1  # and the others are told all the same
    said = capsys.readouterr()
    assert "demo_seconds" in said.out
    assert "cores: there is one core" in said.err
    monkeypatch.setattr(bench_command, "_parts", lambda command, folder: parts)
    assert main(["bench", "--json", str(tmp_path / "out" / "bench.json")]) == 0
    said = capsys.readouterr().out
    assert "reached" in said
    assert "missed" in said
    document = json.loads((tmp_path / "out" / "bench.json").read_bytes())
    assert (document["demo_seconds"], document["two_cores_over_one"]) == (12.3, 1.5)
    assert document["processor"]
    assert [each["what"] for each in document["figures"]] == ["a map", "a room"]
    assert main(["bench", "--parts", "two"]) == 0
    assert "demo_seconds" not in capsys.readouterr().out
    assert main(["bench", "--parts", "three"]) == 1
    assert "no part three; there are one, two" in capsys.readouterr().err
    assert main(["bench", "--repeats", "0"]) == 1
