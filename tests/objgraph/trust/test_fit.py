"""Fits find what objects were made with, and what they promise holds on objects that they have not seen."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from objgraph.covariance.box_modes import factor_needed
from objgraph.covariance.sides import SideMisfit
from objgraph.errors import CovarianceError
from objgraph.trust.calibration import LEVELS
from objgraph.trust.fit import fit
from objgraph.trust.fitted import Judged, Table, _widenings, folds_of, likeliest_sides, unlikelihood
from objgraph.trust.held_out import held_out
from objgraph.trust.regression import conformal
from tests.objgraph.trust.calibrations import SIDES, objects

PRIORS = {"chair": "a", "table": "b"}


@pytest.fixture(scope="module")
def fitted():
    return fit(objects(600, tail=1.5), PRIORS, {})


def test_the_sides_misfit_is_found():
    found = fit(objects(600), PRIORS, {}).categories["chair"].sides
    assert found.seen == pytest.approx(SIDES.seen, rel=0.25)
    assert found.unseen == pytest.approx(SIDES.unseen, rel=0.25)
    assert 1.0 < found.marginals < 9.0


@settings(max_examples=25, deadline=None)
@given(st.floats(0.3, 8.0), st.floats(0.002, 0.03), st.floats(0.015, 0.3), st.integers(0, 1000))
def test_nothing_is_likelier_than_what_is_found_not_even_the_truth(marginals, seen, unseen, seed):
    truth = SideMisfit(marginals, seen, unseen)
    table = Table(objects(120, seed, misfit=truth))
    everything = np.ones(len(table.errors), bool)
    found = unlikelihood(likeliest_sides(table, everything), table, everything)
    assert found <= unlikelihood(truth, table, everything) + 1e-4


@pytest.mark.parametrize("level", LEVELS)
def test_sets_hold_what_they_say_on_other_objects(fitted, level):
    """Boxes, by the sides' errors and the factor for each object; surfaces by theirs."""
    fresh, share = objects(1500, seed=1, tail=1.5), float(level) / 100
    held, covered = [], []
    for each in fresh:
        of = fitted.categories[each.category]
        matrix = of.sides.widened(each.marginals, each.extents, each.seen_sides)
        needed = factor_needed(each.modes, matrix, float(chi2.ppf(share, 9)))
        held.append(needed <= of.factor("box", each.evidence, level))
        covered.append(each.surface[level] <= of.factor("surface", each.evidence, level))
    assert np.mean(held) == pytest.approx(share, abs=0.05)
    assert np.mean(covered) == pytest.approx(share, abs=0.05)


def test_sets_of_few_shapes_hold_what_they_say():
    """Three objects each of fifteen shapes, which are alike, and evidence that tells nothing: a line fitted to them follows
    them, so that what is left of them over it is too little. By the other shapes' line sets of 95 % hold .95, by their own .92."""
    rng, n = np.random.default_rng(0), 45
    held = {"others": [], "own": []}
    for _ in range(200):
        X = np.c_[np.ones(n), rng.normal(size=(n, 7))]
        needed = (rng.normal(size=15).repeat(3) + 0.5 * rng.normal(size=n))[:, None].repeat(3, axis=1)
        fold = folds_of([f"{i // 3}" for i in range(n)])
        table: Any = SimpleNamespace(X=X, folds=lambda fold=fold: fold)
        lines, factors = _widenings({"chair": table}, {"chair": needed}, {"chair": np.ones(n, bool)})
        own = np.exp(conformal(needed[:, 2] - X @ lines["chair"], 0.95))
        others = np.c_[np.ones(100), rng.normal(size=(100, 7))]
        theirs = np.hypot(1.0, 0.5) * rng.normal(size=100) - others @ lines["chair"]
        for name, factor in (("others", factors["chair"][2]), ("own", own)):
            held[name].append(np.mean(np.exp(theirs) <= factor))
    assert np.mean(held["others"]) == pytest.approx(0.95, abs=0.015)
    assert np.mean(held["own"]) < 0.925


def test_verdicts_are_probabilities(fitted):
    """Of other objects, by how sure it is: as many are right as it says."""
    fresh = objects(2000, seed=2, tail=1.5)
    said = np.array([fitted.categories[o.category].trust(o.evidence, "").pose for o in fresh])
    right = np.array([o.pose_right for o in fresh])
    for low, high in ((0, 0.3), (0.3, 0.7), (0.7, 1.0)):
        some = (said >= low) & (said < high)
        assert some.sum() > 100
        assert right[some].mean() == pytest.approx(said[some].mean(), abs=0.1)
    assert np.mean((said - right) ** 2) < 0.8 * right.mean() * (1 - right.mean())


def test_objects_that_are_seen_less_are_widened_more(fitted):
    seen = objects(1)[0].evidence
    factors = [
        fitted.categories["chair"].factor("box", replace(seen, seen=share)) for share in (0.2, 0.5, 0.8)
    ]
    assert factors == sorted(factors, reverse=True)


def test_held_out_figures_are_of_folds_that_share_no_shape(monkeypatch):
    """A shape's two objects are judged by a fit that saw neither."""
    from objgraph.trust import fitted as module

    made, seen = objects(160), []
    true = module._widths

    def watched(table, chosen):
        seen.append(chosen)
        return true(table, chosen)

    monkeypatch.setattr(module, "_widths", watched)
    entries = held_out(made, seed=3)
    assert [entry["of"] for entry in entries] == ["all", "chair", "table", "made up"]
    assert [entry["objects"] for entry in entries] == [160, 80, 80, 160]
    assert len(seen) == 20
    for category, folds in (("chair", seen[::2]), ("table", seen[1::2])):
        shapes = np.array([each.shape for each in made if each.category == category])
        assert all(set(shapes[chosen]).isdisjoint(shapes[~chosen]) for chosen in folds)
        np.testing.assert_array_equal(np.sum([~chosen for chosen in folds], axis=0), 1)


def test_a_mask_with_a_neighbour_in_it_does_not_speak_for_all():
    """One object in ten a metre off leaves the sides' misfit nearly as it was."""
    made = objects(400)
    stray = [replace(o, modes=[(1.0, o.modes[0][1] + np.r_[0, 0, 0, 1, 1, 1, 0, 0, 0])]) for o in made[::10]]
    found = fit([*made, *stray], PRIORS, {}).categories["table"].sides
    assert found.seen < 2 * SIDES.seen
    assert found.unseen < 1.5 * SIDES.unseen


def of_chairs(**changes) -> list[Judged]:
    return [replace(each, category="chair", **changes) for each in objects(60)]


@pytest.mark.parametrize(
    "made",
    [
        objects(60)[:39],
        [replace(o, modes=[(1.0, o.modes[0][1] + np.eye(9)[1])]) for o in of_chairs()],
        [],
    ],
)
def test_what_cannot_be_calibrated_says_what_is_due(made):
    with pytest.raises(CovarianceError, match=r"no category has enough objects .*at least 40 are due"):
        fit(made, PRIORS, {})


def test_of_one_shape_nothing_is_held_out():
    made = [replace(each, shape="the only one") for each in of_chairs()]
    found = fit(made, PRIORS, {})
    assert found.categories["chair"].objects == 60
    assert found.made["held_out"] == []


def test_a_category_of_few_objects_leans_on_the_others():
    """What evidence is worth to its verdicts is nearer to what it is worth to the others' than alone."""
    made = objects(1200)
    many, few = [each for each in made if each.category == "chair"], made[1:90:2]
    alone, common = fit(few, PRIORS, {}), fit([*many, *few], PRIORS, {})

    def apart(found) -> float:
        mine, others = found.categories["table"].pose.weights, common.categories["chair"].pose.weights
        return float(np.linalg.norm([mine[name] - others[name] for name in others]))

    assert apart(common) < 0.7 * apart(alone)
    # of many objects their own weights are what they would be alone
    chairs = fit(many, PRIORS, {}).categories["chair"].pose.weights
    both = common.categories["chair"].pose.weights
    assert both == pytest.approx(chairs, abs=0.1)


def test_evidence_that_is_the_same_for_all_moves_no_verdict_by_much():
    """A category without a first guess beside one with: the others' weight must not be for a billionth."""
    made = objects(600)
    without = [
        replace(each, evidence=replace(each.evidence, guess=1.0)) if each.category == "table" else each
        for each in made
    ]
    table = fit(without, PRIORS, {}).categories["table"]
    usual = without[1].evidence
    said = [table.trust(replace(usual, guess=guess), "").pose for guess in (1.0, 0.9)]
    assert said[0] == pytest.approx(said[1], abs=0.1)


@pytest.mark.parametrize("right", [True, False])
def test_where_all_are_right_or_wrong_the_next_one_need_not_be(right: bool):
    """Of 60 alike the next one is wrong once in 62 (Laplace)."""
    made = of_chairs(pose_right=right, shape_right=right)
    found = fit(made, PRIORS, {})
    usual = [found.categories["chair"].trust(each.evidence, "") for each in made]
    for said in ([each.pose for each in usual], [each.shape for each in usual]):
        assert np.mean(said) == pytest.approx(61 / 62 if right else 1 / 62, abs=0.01)


def test_a_category_of_too_few_objects_is_left_out_and_told():
    found = fit([*of_chairs(), *objects(60)[1::2]], PRIORS, {"seed": 1})
    assert set(found.categories) == {"chair"}
    assert found.categories["chair"].objects == 60
    assert found.made["too_few"] == {"table": 30}
    assert found.made["seed"] == 1
    assert [entry["objects"] for entry in found.made["held_out"]] == [60, 60, 60]
