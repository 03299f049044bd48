"""Files of `objgraph calibrate`: any change of a good one's."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.trust.calibration import load_calibration
from tests.fuzz.inputs import attempt, fuzzed, replaced
from tests.fuzz.strategies import changed, damaged, encoded
from tests.objgraph.trust.calibrations import EVIDENCE, calibration


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "calibration.json"
    calibration().save(path)
    return path


def judge(path: Path) -> None:
    """Read it, and ask what it says."""
    known = load_calibration(path)
    for of in known.categories.values():
        assert of.trust(EVIDENCE, known.digest).pose > 0


@fuzzed
@given(data=st.data())
def test_a_calibration_with_other_values(good, data):
    document = json.loads(good.read_text())
    with replaced(good.parent, good, encoded(data.draw(changed(document)))):
        attempt(judge, good)


@fuzzed
@given(data=st.data())
def test_a_damaged_calibration(good, data):
    with replaced(good.parent, good, data.draw(damaged(good))):
        attempt(judge, good)
