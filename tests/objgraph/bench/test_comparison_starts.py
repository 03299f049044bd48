"""Where methods begin: the mean shape by ICP, and rows of either start."""

from dataclasses import replace
from importlib import import_module

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.bench.comparison.contenders.methods import METHODS
from objgraph.bench.comparison.objects.compare import Comparison, compare, starts_apart
from objgraph.bench.comparison.objects.measure import Job, measure
from objgraph.bench.comparison.objects.rows import ObjectRow, contender, method_and_start
from objgraph.bench.comparison.objects.starts import mean_shape_by_icp
from objgraph.bench.comparison.objects.summary import summarize
from objgraph.errors import InitialisationError
from objgraph.observation.sampling import SamplingConfig, observe
from tests.objgraph.bench.comparison_fakes import FAST, UP, FakeCase, FakeSource, install
from tests.toys import toy_frame, toy_prior, toy_state

measure_module = import_module(measure.__module__)


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    install(monkeypatch)


def rows_of(*contenders: str) -> dict[str, ObjectRow]:
    job = Job(FakeCase(0), "fake", 2, dict.fromkeys(contenders, "s"), FAST)
    return {row.contender: row for row in measure(job, FAST)}


@settings(max_examples=6)
@given(st.floats(-3.1, 3.1))
def test_icp_places_the_mean_shape(heading):
    """Of an object that is the mean shape at nearly the mean size."""
    prior = toy_prior()
    state = toy_state(heading)
    views = [
        observe(toy_frame([state], azimuth, seed=i), 1, SamplingConfig(points=400))
        for i, azimuth in enumerate((0.3, 2.0, 4.0))
    ]
    found = mean_shape_by_icp(prior, views, UP)
    np.testing.assert_array_equal(found.code, prior.code_mean)
    assert np.ptp(found.log_scale) == 0
    assert np.exp(found.log_scale[0]) == pytest.approx(prior.size_mean)
    off = np.linalg.norm(found.T_world_object.translation() - state.T_world_object.translation())
    assert off < 0.12
    # it leans no more than points and shape differ by
    assert found.T_world_object.rotation().matrix()[2, 1] > 0.95
    single = mean_shape_by_icp(prior, views, UP, one_scale=True)
    assert np.ptp(single.log_scale) == 0
    assert single.log_scale[0] != found.log_scale[0]


def test_too_few_points_are_refused():
    with pytest.raises(InitialisationError, match="0 points"):
        mean_shape_by_icp(toy_prior(), [], UP)


def test_either_start_has_rows_of_its_own():
    rows = rows_of("near", "near@own", "start", "start@own", "start-7dof@own")
    assert list(rows) == ["near", "near@own", "start", "start@own", "start-7dof@own"]
    assert all(row.failure is None for row in rows.values())
    assert {row.start for name, row in rows.items() if "@" in name} == {"own"}
    assert rows["near"].start_T_world_object == rows["start"].T_world_object
    assert rows["near@own"].start_T_world_object == rows["start@own"].T_world_object
    assert rows["near"].start_T_world_object != rows["near@own"].start_T_world_object
    assert rows["start@own"].scale != rows["start-7dof@own"].scale
    assert all(row.start_seconds is not None and row.start_seconds > 0 for row in rows.values())
    # the two that share one share its time
    assert rows["near"].start_seconds == rows["start"].start_seconds
    assert starts_apart(list(rows.values())) == []


def test_whose_own_start_is_the_shared_one_is_estimated_once(monkeypatch):
    monkeypatch.setitem(
        METHODS, "near", METHODS["near"].__class__(METHODS["near"].estimator, FAST.sampling, "best")
    )
    rows = rows_of("near", "near@own")
    shared, own = rows["near"], rows["near@own"]
    assert (shared.T_world_object, shared.seconds) == (own.T_world_object, own.seconds)
    assert own.start == "own"


def test_a_start_whose_headings_were_guessed_is_not_one_without(monkeypatch):
    """One heading that is left of a guess is another task than the same state alone, and is estimated by itself."""
    asked = []

    def watched(row, case, seen, start, views, config):
        asked.append((row.contender, start.chances))
        return row

    monkeypatch.setattr(measure_module, "_estimated", watched)
    found = measure_module.find_start
    monkeypatch.setattr(
        measure_module, "find_start", lambda *given: replace(found(*given).first(), chances=(1.0,))
    )
    monkeypatch.setitem(
        METHODS, "near", METHODS["near"].__class__(METHODS["near"].estimator, FAST.sampling, "best")
    )
    rows_of("near", "near@own")
    assert asked == [("near", ()), ("near@own", (1.0,))]


def test_figures_are_by_method_and_start(tmp_path):
    comparison = Comparison(FakeSource((FakeCase(0),)), ("near", "near@own", "start"), (2,), tmp_path, FAST)
    rows = compare(comparison)
    entries = summarize(rows, comparison.methods)
    assert [(e["contender"], e["method"], e["start"]) for e in entries] == [
        ("near", "near", "shared"), ("near@own", "near", "own"), ("start", "start", "shared"),
    ]  # fmt: skip
    assert all(e["start_seconds"] > 0 for e in entries)
    assert all(e["shapes"] == "toys" for e in entries)
    assert all(row.prior and row.seed == FAST.seed for row in rows)
    # and it goes on from what is there
    assert [row.seconds for row in compare(comparison)] == [row.seconds for row in rows]


@given(st.sampled_from(["graph", "dsp-slam-gn", "ours+clipping"]), st.sampled_from(["shared", "own"]))
def test_contenders_name_method_and_start(method, start):
    assert method_and_start(contender(method, start)) == (method, start)
    assert (contender(method, start) == method) == (start == "shared")


def test_the_standing_start_is_what_was_found():
    state = toy_state(0.3)
    rows = rows_of("start")
    pose = gtsam.Pose3(np.array(rows["start"].T_world_object))
    assert pose.equals(gtsam.Pose3(np.array(rows["start"].start_T_world_object)), 1e-12)
    assert rows["start"].box_covariance is None
    assert rows["start"].translation_m is not None
    assert rows["start"].translation_m < 0.05
    assert np.linalg.norm(pose.translation() - state.T_world_object.translation()) < 0.05
