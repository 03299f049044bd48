"""The harness on toy objects: one start for all, failures that count, resumption, and processes that agree."""

import json
from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest

from objgraph.bench.comparison.contenders.methods import METHODS, Method
from objgraph.bench.comparison.objects import config as comparison_config
from objgraph.bench.comparison.objects import measure as comparing_measure
from objgraph.bench.comparison.objects import starts
from objgraph.bench.comparison.objects.compare import CSV, ROWS, Comparison, compare, starts_apart
from objgraph.bench.comparison.objects.measure import Job, measure
from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.running.store import SETTINGS
from objgraph.errors import EvaluationError
from objgraph.estimate.graph import GraphEstimator
from objgraph.graph.initialise import FirstStates
from objgraph.work import Workers
from tests.objgraph.bench.comparison_fakes import (
    FAST,
    THIN,
    FakeCase,
    FakeEstimator,
    FakeSource,
    install,
    row,
)
from tests.toys import toy_prior

TIMES = ("seconds", "seconds_cpu", "start_seconds")


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    install(monkeypatch)


@pytest.fixture
def calls(monkeypatch) -> Counter:
    """Rows without the work; counts how often each is made."""
    made: Counter = Counter()

    def quick(job: Job, config, version=""):
        case = job.case
        for name, digest in job.todo.items():
            made[name, case.id, job.views] += 1
            values = {"category": case.category, "shape": case.shape, "settings": digest}
            yield row(name, case.id, job.views, chamfer_m=0.01 * len(made), **values)

    monkeypatch.setattr(comparing_measure, "measure", quick)
    return made


def same(a: ObjectRow, b: ObjectRow) -> list[tuple]:
    """Fields that differ by more than rounding, without the times."""
    pairs = ((field.name, getattr(a, field.name), getattr(b, field.name)) for field in fields(ObjectRow))
    return [
        (name, x, y)
        for name, x, y in pairs
        if name not in TIMES
        and not (x == y or (np.size(x) == np.size(y) and np.allclose(x, y, rtol=2e-3, atol=1e-6)))
    ]


def toy_comparison(tmp_path, methods=("near", "far"), cases=2, views=(1, 2), **values) -> Comparison:
    source = FakeSource(tuple(FakeCase(i) for i in range(cases)), **values)
    return Comparison(source, tuple(methods), views, tmp_path / "out", FAST)


def measured(*methods: str, case: FakeCase | None = None, views: int = 2) -> dict[str, ObjectRow]:
    job = Job(case or FakeCase(1), "fake", views, dict.fromkeys(methods, "digest"))
    return {each.method: each for each in measure(job, FAST)}


def test_methods_start_together_and_are_measured():
    rows = measured("near", "far", "bare")
    near, far, bare = rows["near"], rows["far"], rows["bare"]
    assert near.start_T_world_object == far.start_T_world_object == bare.start_T_world_object
    assert near.T_world_object == near.start_T_world_object
    assert near.failure is far.failure is None
    assert near.start_seconds == far.start_seconds
    assert (near.pose_correct, near.iou_correct, near.chamfer_correct) == (True, True, True)
    assert near.well_reconstructed
    assert near.translation_m == pytest.approx(0.01, abs=0.003)
    assert near.rotation_deg == pytest.approx(np.degrees(0.02), abs=0.01)
    assert far.translation_m == pytest.approx(0.3, abs=0.02)
    assert not far.pose_correct
    assert not far.well_reconstructed
    assert near.pearson is not None
    assert -1 <= near.pearson <= 1
    assert near.surface_sigma is not None
    assert near.surface_error is not None
    assert len(near.surface_sigma) == len(near.surface_error) == FAST.kept_points
    assert np.array(near.covariance).shape == (9, 9)
    assert near.box_error is not None
    assert near.rotation_deg is not None
    assert np.linalg.norm(near.box_error[3:6]) == pytest.approx(near.translation_m, abs=1e-6)
    assert np.linalg.norm(near.box_error[:3]) == pytest.approx(np.radians(near.rotation_deg), abs=1e-6)
    assert np.linalg.eigvalsh(np.array(near.box_covariance)).min() > 0
    assert near.heading_error_deg is not None
    assert near.heading_error_deg <= near.rotation_deg + 1e-6
    assert near.surface_residual is not None
    assert near.surface_residual > 0
    assert near.frames == [0, 1]
    # what an estimator gets is drawn as its method says: the fake tells how many points
    assert near.linearizations == 2 * FAST.sampling.points
    assert far.linearizations == 2 * THIN.points
    assert near.error_evaluations == 2
    truth = FakeCase(1).state()
    np.testing.assert_allclose(np.array(near.truth_T_world_object), truth.T_world_object.matrix())
    np.testing.assert_allclose(np.array(near.truth_scale), truth.scale)


def test_without_a_covariance_there_is_no_correlation():
    bare = measured("bare")["bare"]
    assert bare.failure is None
    assert bare.well_reconstructed
    assert bare.pearson is bare.spearman is bare.covariance is bare.surface_sigma is None
    assert bare.box_error is bare.box_covariance is bare.surface_residual is None


def test_a_method_s_failure_is_its_own():
    rows = measured("fails", "raises", "empty", "near")
    assert rows["fails"].failure == "chair-1: it does not converge"
    assert rows["raises"].failure == "RuntimeError: a bug"
    assert "no surface" in (rows["empty"].failure or "")
    assert rows["near"].failure is None
    for name in ("fails", "raises", "empty"):
        correct = (rows[name].pose_correct, rows[name].iou_correct, rows[name].chamfer_correct)
        assert correct == (False, False, False)
        assert rows[name].chamfer_m is None
        assert rows[name].start_scale is not None
    assert rows["empty"].T_world_object is not None


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("scan", "OSError: the disk is gone"),
        ("views", "no frame sees it"),
        ("masks", "no view can be used: frame 1/0, object 1"),
    ],
)
def test_an_object_s_failure_is_every_method_s(fault, words):
    rows = measured("near", "far", case=FakeCase(1, fault=fault), views=1)
    assert [words in (each.failure or "") for each in rows.values()] == [True, True]


def test_a_cost_that_is_no_number_is_none():
    assert measured("nan")["nan"].cost_initial is None


def test_rows_come_in_order_and_as_csv(tmp_path):
    comparison = toy_comparison(tmp_path)
    told = []
    rows = compare(comparison, tell=lambda *what: told.append(what))
    order = [(each.method, each.case, each.views) for each in rows]
    assert order == [(m, f"chair-{i}", v) for m in ("near", "far") for i in (0, 1) for v in (1, 2)]
    assert len((comparison.out / CSV).read_text().splitlines()) == 9
    assert told[0] == ("estimating", 0, 8)
    assert told[-1][1:] == (8, 8)
    assert {each.version for each in rows} == {""}


def test_processes_give_what_one_process_gives_and_one_that_dies_is_told(tmp_path):
    one = compare(toy_comparison(tmp_path / "one", methods=("near", "fails", "far"), cases=3))
    comparison = toy_comparison(tmp_path / "two", methods=("near", "fails", "far"), cases=3)
    dying = FakeSource((*map(FakeCase, range(3)), FakeCase(7, fault="dies")))
    with pytest.raises(EvaluationError, match=r"at .*chair-7 with 1 view.* died"):
        compare(replace(comparison, source=dying), workers=Workers(2))
    done = (comparison.out / ROWS).read_text().splitlines()
    assert len(done) == 18  # all but the one's
    two = compare(comparison)
    assert (comparison.out / ROWS).read_text().splitlines()[: len(done)] == done
    assert [same(a, b) for a, b in zip(one, two, strict=True)] == [[]] * 18
    assert sum(each.failure is None for each in one) == 12


def test_a_kill_at_any_byte_costs_a_row_at_most(tmp_path, calls):
    comparison = toy_comparison(tmp_path, cases=3)
    compare(comparison)
    path = comparison.out / ROWS
    data = path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(data) if byte == ord("\n")]
    assert len(ends) == 12
    for cut in sorted({0, 1, *range(0, len(data), 97), *ends, *(end - 1 for end in ends)}):
        path.write_bytes(data[:cut])
        calls.clear()
        rows = compare(comparison)
        assert len(calls) == 12 - sum(end <= cut for end in ends)
        assert set(calls.values()) <= {1}
        assert len(rows) == 12
        assert path.read_bytes().count(b"\n") == 12


def test_what_is_stopped_goes_on(tmp_path, calls, monkeypatch):
    comparison = toy_comparison(tmp_path)
    quick = comparing_measure.measure

    def stopped(job: Job, config, version=""):
        if job.case.id == "chair-1":
            raise KeyboardInterrupt
        yield from quick(job, config, version)

    with monkeypatch.context() as patch:
        patch.setattr(comparing_measure, "measure", stopped)
        with pytest.raises(KeyboardInterrupt):
            compare(comparison)
    assert sum(calls.values()) == 4
    compare(comparison)
    assert sum(calls.values()) == 8
    assert set(calls.values()) == {1}


def test_more_methods_views_and_objects_are_added(tmp_path, calls):
    compare(toy_comparison(tmp_path, methods=("near",), views=(1,), cases=1))
    rows = compare(toy_comparison(tmp_path, methods=("near", "far"), views=(1, 3), cases=2))
    assert len(rows) == 8
    assert set(calls.values()) == {1}
    assert len(calls) == 8
    # and a smaller selection sees its own rows alone
    assert len(compare(toy_comparison(tmp_path, methods=("far",), views=(3,), cases=1))) == 1


def test_failed_rows_are_run_again_when_asked(tmp_path, monkeypatch):
    comparison = toy_comparison(tmp_path, methods=("near", "flaky"), cases=1, views=(1,))
    monkeypatch.setitem(METHODS, "flaky", METHODS["fails"])
    assert compare(comparison)[1].failure is not None
    mended = Method(lambda: Mended(fault="solve"), METHODS["fails"].sampling)
    monkeypatch.setitem(METHODS, "flaky", mended)
    assert compare(comparison)[1].failure is not None
    assert compare(comparison, retry_failed=True)[1].failure is None
    assert compare(comparison)[1].failure is None


class Mended(FakeEstimator):
    """Of the same settings, without its bug."""

    __qualname__ = "FakeEstimator"

    def _one(self, task):
        return FakeEstimator()._one(task)


def test_methods_that_did_not_start_alike_are_told(tmp_path, monkeypatch, caplog):
    comparison = toy_comparison(tmp_path, methods=("near",), cases=2, views=(1,))
    compare(comparison)
    both = replace(comparison, methods=("near", "far"))
    with monkeypatch.context() as patch:
        moved = FakeCase(0).state().retract(np.full(13, 0.01))
        patch.setattr(starts, "first_states", lambda *_: FirstStates((moved,)))
        rows = compare(both, version="2")
    assert starts_apart(rows) == [("chair-0", 1), ("chair-1", 1)]
    assert "did not start alike on 2 of the objects" in caplog.text
    assert starts_apart([each for each in rows if each.method == "near"]) == []


def refused(comparison: Comparison) -> str:
    with pytest.raises(EvaluationError) as caught:
        compare(comparison)
    return str(caught.value)


def test_other_settings_are_refused(tmp_path, calls, monkeypatch):
    comparison = toy_comparison(tmp_path)
    compare(comparison)
    out = str(comparison.out)
    message = refused(replace(comparison, config=replace(FAST, mesh_resolution=32)))
    assert out in message
    assert "common.mesh_resolution: 24 before, 32 now" in message
    message = refused(toy_comparison(tmp_path, seed=5))
    assert "data.seed: 0 before, 5 now" in message
    assert message.count(" before, ") == 1, "what has not changed is not named"
    with monkeypatch.context() as patch:
        patch.setitem(METHODS, "near", Method(lambda: FakeEstimator(step=0.1), FAST.sampling))
        message = refused(comparison)
        assert "'near'" in message
        assert "method.estimator.step: 0.0 before, 0.1 now" in message
        # the other method's rows are as they were
        assert len(compare(replace(comparison, methods=("far",)))) == 4
    other = replace(toy_prior(), card={"sha256": "other weights"})
    monkeypatch.setattr(comparison_config, "find_prior", lambda category, files: other)
    assert "prior: toy before, other weights now" in refused(comparison)
    other = replace(toy_prior(), surface_misfit=2.0)
    message = refused(comparison)
    assert "surface_misfit: 1.0 before, 2.0 now" in message
    assert len(calls) == 8
    (comparison.out / "settings.json").unlink()
    assert "made with other settings" in refused(comparison)


def test_settings_that_are_functions_or_plain_objects_have_stable_digests():
    class Plain:
        def __init__(self, value):
            self.value, self.call = value, max

    one, same, other = (comparison_config.settings_of(Plain(value)) for value in (1, 1, 2))
    assert one == same != other
    assert "0x" not in json.dumps(one)


def test_who_watches_is_no_setting():
    watched = comparison_config.settings_of(GraphEstimator(watch=print))
    assert watched == comparison_config.settings_of(GraphEstimator())
    assert watched != comparison_config.settings_of(GraphEstimator(gravity=False))


def test_what_cannot_be_compared_is_a_typed_error(tmp_path):
    with pytest.raises(EvaluationError, match="no object is left"):
        compare(toy_comparison(tmp_path, cases=0))
    with pytest.raises(EvaluationError, match=r"no method 'fly'; available: .*graph"):
        compare(toy_comparison(tmp_path, methods=("fly",)))
    twice = FakeSource((FakeCase(1), FakeCase(1)))
    with pytest.raises(EvaluationError, match="two objects are called chair-1"):
        compare(replace(toy_comparison(tmp_path), source=twice))
    assert SETTINGS not in [path.name for path in tmp_path.rglob("*")]
