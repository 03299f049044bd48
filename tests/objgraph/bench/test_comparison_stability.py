"""The same objects again: spreads by hand, and what counts as another mode."""

import numpy as np
import pytest

from objgraph.bench.comparison.objects.compare import Comparison
from objgraph.bench.comparison.objects.stability import SEEDS, changes_mode, compare_again, stability
from tests.objgraph.bench.comparison_fakes import FAST, FakeCase, FakeSource, install, row

EYE = np.eye(4).tolist()


def turned(degrees: float) -> list[list[float]]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    T = np.eye(4)
    T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    return T.tolist()


def found(heading: float = 0.0, x: float = 0.0, recall: float = 0.9, symmetry: int = 1, **values):
    return row(
        T_world_object=turned(heading), truth_T_world_object=EYE, truth_symmetry=symmetry, centre_world=[x, 0.0, 0.0],
        extents=[1.0 + x, 1.0, 1.0], chamfer_m=0.02 + x, recall=recall, **values,
    )  # fmt: skip


def test_spreads_by_hand():
    runs = [[found(h, x)] for h, x in ((2.0, 0.0), (-2.0, 0.0), (2.0, 0.02), (-2.0, 0.02))]
    (entry,) = stability(runs)
    assert entry["n"] == 1
    assert entry["n_failed"] == 0
    assert entry["spread_m"] == pytest.approx(0.01)
    assert entry["spread_deg"] == pytest.approx(2.0)
    assert entry["spread_extents_m"] == pytest.approx(0.01)
    assert entry["spread_chamfer_m"] == pytest.approx(0.01)
    assert entry["threads_m"] == pytest.approx(0.02)
    assert entry["mode_changes"] == 0


@pytest.mark.parametrize(
    ("headings", "symmetry", "changes"),
    [
        ((0, 44), 1, False), ((0, 46), 1, True), ((170, -170), 1, False), ((0, 180), 1, True), ((0, 180), 2, False),
        ((0, 90), 2, True), ((0, 90), 4, False), ((0, 46), 4, False), ((0, 77), 0, False),
    ],
)  # fmt: skip
def test_another_heading_is_another_mode_but_for_symmetry(headings, symmetry, changes):
    assert changes_mode([found(h, symmetry=symmetry) for h in headings]) == changes


def test_a_lost_part_is_another_mode():
    assert changes_mode([found(recall=0.9), found(recall=0.79)])
    assert not changes_mode([found(recall=0.9), found(recall=0.81)])


def test_symmetric_headings_have_the_spread_within_a_period():
    (entry,) = stability([[found(h, symmetry=2)] for h in (1.0, 179.0, 1.0, -1.0)])
    assert entry["spread_deg"] == pytest.approx(1.0, rel=1e-6)
    (any_heading,) = stability([[found(h, symmetry=0)] for h in (0.0, 70.0)])
    assert any_heading["spread_deg"] == 0


def test_objects_that_ever_fail_are_counted_apart():
    runs = [[found(case="a"), found(case="b")], [found(case="a"), row(case="b", failure="lost")]]
    (entry,) = stability(runs)
    assert (entry["n"], entry["n_failed"]) == (1, 1)
    (none,) = stability([[row(failure="lost")]])
    assert none["spread_m"] is none["mode_changes"] is none["threads_m"] is None


def test_every_run_is_made_and_kept(tmp_path, monkeypatch):
    install(monkeypatch)
    comparison = Comparison(FakeSource((FakeCase(0),)), ("near", "bare"), (2,), tmp_path, FAST)
    runs = compare_again(comparison)
    assert len(runs) == SEEDS + 1
    assert len({run[0].settings for run in runs}) == SEEDS + 1
    assert len(list(tmp_path.glob("again-*/objects.jsonl"))) == SEEDS + 1
    entries = stability(runs)
    assert [e["contender"] for e in entries] == ["near", "bare"] or [e["contender"] for e in entries] == [
        "bare",
        "near",
    ]
    # the fakes do not draw
    assert all(e["spread_m"] == pytest.approx(0, abs=1e-9) and e["n"] == 1 for e in entries)
    seconds = [row.seconds for run in runs for row in run]
    assert [row.seconds for run in compare_again(comparison) for row in run] == seconds
