"""What a calibration says of an object, and its file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.covariance.box import BOX_AXES, BoxPose
from objgraph.covariance.labelled import LabelledCovariance
from objgraph.errors import CovarianceError
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.registry import load_prior, prior_for
from objgraph.trust.calibration import Calibration, load_calibration, shipped_calibration
from objgraph.trust.verdict import Trust
from tests.objgraph.trust.calibrations import EVIDENCE, SIDES, calibration
from tests.toys import toy_state

CHAIR = calibration().categories["chair"]


def test_a_verdict_is_the_logistic_function_of_the_evidence():
    trust = CHAIR.trust(replace(EVIDENCE, seen=0.7), "digest")
    assert trust.calibration == "digest"
    z = (0.7 - 0.5) / 0.2
    odds = 0.6 + 1.5 * z - 1.0 * EVIDENCE.moved / 0.2
    assert trust.pose == pytest.approx(1 / (1 + np.exp(-odds)))
    assert trust.shape == pytest.approx(1 / (1 + np.exp(-(odds - 1.5))))
    assert trust.word == "likely"
    assert trust.why == ()
    assert trust.evidence == replace(EVIDENCE, seen=0.7).to_json()


def test_what_speaks_against_it_is_said_the_worst_first():
    trust = CHAIR.trust(replace(EVIDENCE, seen=0.1, moved=0.2), "")
    assert trust.why == ("little of its surface is seen", "it ended far from the first guess")
    assert trust.word == "poor"


@pytest.mark.parametrize(("category", "prior"), [("chair", "other weights"), ("sofa", "weights")])
def test_of_objects_that_it_does_not_know_it_says_nothing(category, prior):
    assert calibration().of(category, prior) is None


@pytest.mark.parametrize(
    ("label", "category"),
    [("trash_bin", "Trash bin"), ("chair", "Chair"), ("office chair", "chair"), ("floor lamp", "Floor_Lamp")],
)
def test_what_it_knows_of_a_label_it_knows_of_the_prior_that_serves_it(label, category):
    """Rows have the label of a data set, a prior the name that it was given; both may be known, of priors of their own."""
    served = replace(fallback_prior(category), card={"sha256": "weights"})
    assert prior_for(label, [served]) is served
    known = Calibration({label: CHAIR}, {})
    assert known.of(served.category, served.digest) is CHAIR
    assert known.of(served.category, "other weights") is None
    own = replace(CHAIR, prior="own")
    both = Calibration({label: CHAIR, category: own}, {})
    assert both.of(category, "own") is own
    assert both.of(category, "weights") is CHAIR


def test_a_box_is_widened_by_its_sides_and_by_what_its_evidence_lets_expect():
    state = toy_state()
    box = BoxPose(
        state.T_world_object,
        np.array([0.5, 0.9, 0.6]),
        LabelledCovariance(1e-4 * np.eye(9), BOX_AXES, "marginals", "chair 1"),
    )
    seen = np.full((3, 2), 0.4)
    found = CHAIR.box(replace(EVIDENCE, seen=0.7), box, seen)
    factor = 3.0 * np.exp(0.2 - 0.5)
    expected = factor * (SIDES.marginals * 1e-4 * np.eye(9) + SIDES.matrix(box.extents, seen))
    np.testing.assert_allclose(found.covariance.matrix, expected)
    assert found.T_world_box is box.T_world_box
    trust = CHAIR.trust(replace(EVIDENCE, seen=0.7), "")
    # the map has the box at 95 % already, and the surface as the graph gives it
    assert trust.widening["box"] == pytest.approx({"50": 1 / 3, "90": 2 / 3, "95": 1.0})
    assert trust.widening["surface"] == pytest.approx({"50": factor / 3, "90": factor * 2 / 3, "95": factor})


def test_a_heading_is_no_farther_off_than_half_a_turn():
    """All else, and what goes along with what, stays as it was widened."""
    state, matrix = toy_state(), 1e-4 * np.eye(9)
    matrix[1, 1], matrix[1, 3] = np.pi**2 / 3, 2e-3
    matrix[3, 1] = matrix[1, 3]
    known = LabelledCovariance(matrix, BOX_AXES, "marginals", "stool 1")
    seen, extents = np.full((3, 2), 0.4), np.array([0.5, 0.9, 0.6])
    found = CHAIR.box(EVIDENCE, BoxPose(state.T_world_object, extents, known), seen).covariance
    free = CHAIR.factor("box", EVIDENCE) * SIDES.widened(matrix, extents, seen)
    assert free[1, 1] > np.pi**2
    assert found.sigma[1] == pytest.approx(np.pi)
    others = [0, *range(2, 9)]
    np.testing.assert_allclose(found.matrix[np.ix_(others, others)], free[np.ix_(others, others)])
    assert found.correlation[1, 3] == pytest.approx(free[1, 3] / np.sqrt(free[1, 1] * free[3, 3]))


def test_evidence_beyond_all_that_was_seen_says_no_more():
    """Four deviations are the most: a line that was fitted within them is not drawn on without end."""
    of = CHAIR
    at, beyond = (replace(EVIDENCE, seen=of.mean["seen"] + k * of.spread["seen"]) for k in (4.0, 40.0))
    less = replace(EVIDENCE, seen=of.mean["seen"] + 3.9 * of.spread["seen"])
    assert of.trust(beyond, "").pose == pytest.approx(of.trust(at, "").pose)
    assert of.trust(less, "").pose != pytest.approx(of.trust(at, "").pose, rel=1e-6)
    assert of.factor("box", beyond) == pytest.approx(of.factor("box", at))


def test_a_file_comes_back_as_it_was(tmp_path):
    known = calibration()
    known.save(tmp_path / "c.json")
    again = load_calibration(tmp_path / "c.json")
    assert again == known
    assert again.digest == known.digest != calibration("other").digest


@pytest.mark.parametrize(
    "damage",
    [
        lambda d, c: d.update(version=2),
        lambda d, c: d.update(categories=[1]),
        lambda d, c: d.update(colour=1),
        lambda d, c: d["categories"].update(sofa=3),
        lambda d, c: c.pop("mean"),
        lambda d, c: c["mean"].pop("seen"),
        lambda d, c: c["spread"].update(seen=0.0),
        lambda d, c: c["pose"]["weights"].update(colour=1.0),
        lambda d, c: c["pose"].update(intercept="x"),
        lambda d, c: c["widening"].pop("surface"),
        lambda d, c: c["widening"]["box"]["factors"].update({"95": -1.0}),
        lambda d, c: c["widening"]["box"].pop("line"),
        lambda d, c: c["sides"].pop("seen"),
        lambda d, c: c["sides"].update(seen=-0.1),
        lambda d, c: c.update(prior=1),
        lambda d, c: c.update(colour=1),
    ],
)
def test_a_damaged_file_is_named(tmp_path, damage):
    path = tmp_path / "c.json"
    document = json.loads(calibration().to_bytes())
    damage(document, document["categories"]["chair"])
    path.write_text(json.dumps(document))
    with pytest.raises(CovarianceError, match=r"c\.json: no calibration of this version"):
        load_calibration(path)


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b'{"version": 1}', b"\xff", b"3"])
def test_what_is_no_calibration_is_named(tmp_path, content):
    (tmp_path / "c.json").write_bytes(content)
    with pytest.raises(CovarianceError, match=r"c\.json"):
        load_calibration(tmp_path / "c.json")
    with pytest.raises(CovarianceError, match="absent"):
        load_calibration(tmp_path / "absent")


@given(st.floats(0, 1))
def test_words_follow_the_probability(pose):
    word = Trust(pose, 0.5).word
    assert 1 <= Trust(pose, 0.5).percent <= 99
    assert word == (
        "sure" if pose >= 0.9 else "likely" if pose >= 0.7 else "doubtful" if pose >= 0.4 else "poor"
    )


@pytest.mark.parametrize("values", [{"pose": 1.2}, {"pose": float("nan")}, {"pose": 0.5, "shape": -1}])
def test_verdicts_that_are_none_are_refused(values):
    with pytest.raises(CovarianceError, match="probability"):
        Trust(**{"shape": 0.5, **values})
    with pytest.raises(CovarianceError, match="widening of box"):
        Trust(0.5, 0.5, widening={"box": {"95": 0.0}})


def test_the_shipped_one_is_of_the_shipped_priors():
    known = shipped_calibration()
    assert set(known.categories) == {
        "bathtub", "bed", "bookshelf", "cabinet", "chair", "display", "sofa", "table", "trash_bin"
    }  # fmt: skip
    for category, of in known.categories.items():
        assert load_prior(category).card["sha256"] == of.prior
        assert of.objects >= 100
        # what is seen more is trusted more, and is known better
        usual = replace(EVIDENCE, off=0.01, through=0.0)
        some, more = (replace(usual, seen=share) for share in (0.3, 0.7))
        assert of.trust(some, "").pose < of.trust(more, "").pose
        sizes = [
            of.factor("box", each) * of.sides.matrix(np.ones(3), np.full((3, 2), each.seen))[6, 6]
            for each in (some, more)
        ]
        assert sizes[0] > sizes[1]
        assert of.sides.seen < 0.02
        assert of.sides.unseen > 0.01
