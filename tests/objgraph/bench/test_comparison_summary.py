"""Rates, medians, intervals and paired differences against what can be worked out by hand."""

import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.bench.comparison.objects.summary import WORST, paired, summarize
from objgraph.bench.comparison.writing.behind import behind_table
from objgraph.bench.comparison.writing.bootstrap import Resamples, weighted_medians
from objgraph.bench.comparison.writing.grid import ranged
from tests.objgraph.bench.comparison_fakes import row


def exact_interval(shapes: dict[str, list[float]], statistic) -> tuple[float, float]:
    """The 2.5 % and 97.5 % points of the bootstrap's own law: every way to draw the shapes is as likely."""
    names = list(shapes)
    draws = itertools.product(names, repeat=len(names))
    values = np.sort([statistic(np.concatenate([shapes[name] for name in draw])) for draw in draws])
    return tuple(np.quantile(values, q, method="inverted_cdf") for q in (0.025, 0.975))


SHAPES = {"a": [0.0, 1.0, 1.0], "b": [0.3], "c": [5.0], "d": [2.0, 2.5], "e": [0.7]}


@pytest.mark.parametrize("name", ["mean", "median"])
def test_intervals_are_those_of_shapes_drawn_by_hand(name):
    values = np.concatenate([*SHAPES.values()])
    labels = [name for name, group in SHAPES.items() for _ in group]
    draws = Resamples(labels, seed=3, count=40_000)
    figure, interval = getattr(draws, name)(values)
    statistic = getattr(np, name)
    assert figure == pytest.approx(statistic(values))
    assert interval == pytest.approx(exact_interval(SHAPES, statistic), rel=0.03)


def test_rows_of_a_shape_are_drawn_together():
    weights = Resamples(["a", "b", "a", "c"], seed=0).weights
    assert (weights[:, 0] == weights[:, 2]).all()
    distinct = weights[:, [0, 1, 3]]
    assert (distinct.sum(axis=1) == 3).all()
    assert distinct.mean(axis=0) == pytest.approx(np.ones(3), abs=0.08)


def test_a_single_shape_has_no_interval():
    assert Resamples(["a", "a"]).mean(np.array([0.0, 1.0])) == (0.5, None)
    chosen = np.array([True, True, False, False])
    assert Resamples(["a", "a", "b", "c"]).mean(np.arange(4.0), chosen) == (0.5, None)


def test_a_failure_of_a_single_shape_is_told_as_infinite():
    """And not as a figure that there is none of, which the graph could not be behind by."""
    rows = [row("graph", failure="lost"), row("ours", **good("chair-0", 0.01))]
    entries = summarize(rows, ["graph", "ours"])
    failed, found = entries
    assert ranged(failed, "median_chamfer_m", 100, 1) == "∞ [∞, ∞]"
    assert ranged(failed, "seconds", 1, 1) == "-"
    assert ranged(found, "median_chamfer_m", 100, 1) == "1.0"
    assert "| Chamfer (cm) | ours | 1.0 | graph | ∞ |" in behind_table({"One": {"rows": entries}}).markdown()


def test_a_subset_that_some_draws_miss():
    draws = Resamples(["a", "b", "c"], seed=0)
    figure, interval = draws.mean(np.array([1.0, 2.0, 9.0]), np.array([True, True, False]))
    assert (figure, interval) == (1.5, (1.0, 2.0))
    assert draws.median(np.ones(3), np.zeros(3, bool)) == (None, None)


@given(
    st.lists(st.tuples(st.floats(-5, 5), st.integers(0, 4)), min_size=1, max_size=9).filter(
        lambda pairs: any(count for _, count in pairs)
    )
)
def test_weighted_medians_are_medians_of_repeated_values(pairs):
    values, counts = (np.array(part) for part in zip(*pairs, strict=True))
    expected = np.median(np.repeat(values, counts))
    assert weighted_medians(values, counts[None])[0] == pytest.approx(expected)


def test_infinite_values_have_infinite_ends():
    draws = Resamples(list("abcdef"), seed=0)
    figure, interval = draws.median(np.array([1.0, 2.0, 3.0, 4.0, np.inf, np.inf]))
    assert figure == 3.5
    assert interval is not None
    assert 1 <= interval[0] <= 2
    assert interval[1] == np.inf


def good(case: str, chamfer: float, **values) -> dict:
    fields = {
        "pose_correct": True,
        "iou_correct": True,
        "chamfer_correct": True,
        "translation_m": 2 * chamfer,
    }
    return {
        "case": case,
        "chamfer_m": chamfer,
        "rotation_deg": 100 * chamfer,
        "seconds": 3.0,
        **fields,
        **values,
    }


def test_failures_count_in_every_figure():
    rows = [
        row(**good("c0", 0.01, well_reconstructed=True, pearson=0.6)),
        row(**good("c1", 0.03, well_reconstructed=True, pearson=0.8)),
        row(**good("c2", 0.10, pearson=0.1, seconds=5.0)),
        row(case="c3", failure="lost", seconds=99.0),
        row(case="c4", failure="lost"),
    ]
    (entry,) = summarize(rows, ["near"])
    assert (entry["n"], entry["n_failed"], entry["n_well"], entry["n_shapes"]) == (5, 2, 2, 5)
    assert entry["pose_rate"] == entry["iou_rate"] == entry["chamfer_rate"] == pytest.approx(0.6)
    assert entry["median_chamfer_m"] == pytest.approx(0.10)
    assert entry["median_translation_m"] == pytest.approx(0.20)
    assert entry["median_rotation_deg"] == pytest.approx(10)
    assert entry["pearson"] == pytest.approx(0.7)
    assert entry["seconds"] == 3.0
    assert entry["pose_rate_interval"][0] < 0.6 < entry["pose_rate_interval"][1]
    assert entry["median_chamfer_m_interval"][1] is None  # infinite
    assert entry["pearson_interval"] == [pytest.approx(0.6), pytest.approx(0.8)]
    json.dumps(entry, allow_nan=False)


def test_a_median_over_mostly_failures_is_none():
    rows = [row(**good("c0", 0.01)), row(case="c1", failure="x"), row(case="c2", failure="x")]
    (entry,) = summarize(rows, ["near"])
    assert entry["median_chamfer_m"] is None
    assert entry["pearson"] is None
    assert entry["n_well"] == 0


def test_entries_come_by_category_views_and_method():
    rows = [
        row(method, f"{category}-0", views, category=category)
        for method in ("b", "a")
        for category in ("table", "chair")
        for views in (3, 1)
    ]
    entries = summarize(rows, ["a", "b"])
    order = [(e["category"], e["views"], e["method"]) for e in entries]
    assert order == [(c, v, m) for c in ("table", "chair") for v in (1, 3) for m in ("a", "b")]


def test_paired_differences_by_hand():
    first = [good("c0", 0.01), good("c1", 0.02), good("c2", 0.05), good("c3", 5.0)]
    second = [good("c0", 0.02), good("c1", 0.05), good("c2", 0.04), {"case": "c3", "failure": "lost"}]
    rows = [row("a", **each) for each in first] + [row("b", **each) for each in second]
    rows += [row("a", **good("only a", 0.9))]
    (entry,) = paired(rows, ["a", "b"])
    assert (entry["a"], entry["b"], entry["n"]) == ("a", "b", 4)
    # -0.01, -0.03, 0.01, and 0 where both are as bad as counts
    assert WORST["chamfer_m"] == 1.0
    assert entry["median_chamfer_m"] == pytest.approx(-0.005)
    assert entry["median_translation_m"] == pytest.approx(-0.01)
    # -1, -3, 1 degrees, and 500 cut to 180 like the failure's
    assert entry["median_rotation_deg"] == pytest.approx(-0.5)
    low, high = entry["median_chamfer_m_interval"]
    assert (low, high) == (pytest.approx(-0.03), pytest.approx(0.01))
    assert entry["mean_pearson"] is None
    (turned,) = paired(rows, ["b", "a"])
    assert turned["median_chamfer_m"] == pytest.approx(0.005)


def test_a_failure_of_one_is_the_worst_difference():
    rows = [row("a", **good(f"c{i}", 0.1)) for i in range(3)]
    rows += [row("b", f"c{i}", failure="lost") for i in range(3)]
    (entry,) = paired(rows, ["a", "b"])
    assert entry["median_chamfer_m"] == pytest.approx(-0.9)
    assert entry["median_rotation_deg"] == pytest.approx(10 - 180)


def test_correlations_are_compared_where_both_are_well():
    well = {"well_reconstructed": True}
    rows = [row("a", **good(f"c{i}", 0.1, pearson=0.7, **well)) for i in range(3)]
    rows += [
        row("b", **good("c0", 0.1, pearson=0.5, **well)),
        row("b", **good("c1", 0.1, pearson=0.6, **well)),
    ]
    rows += [row("b", **good("c2", 0.1, pearson=0.1))]
    (entry,) = paired(rows, ["a", "b"])
    assert entry["n_both_well"] == 2
    assert entry["mean_pearson"] == pytest.approx(0.15)
