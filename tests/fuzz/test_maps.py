"""Map files: any change of a good one's."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.maps.object_map import ObjectMap
from objgraph.show.report.contents import map_contents
from tests.fuzz.inputs import attempt, files_in, fuzzed, replaced
from tests.fuzz.strategies import changed, damaged, encoded
from tests.objgraph.maps.map_cases import UP, failed, mapped, other

ERRORS = {"pose_correct": True, "translation_m": 0.02, "rotation_deg": 3.0, "scale_pct": 4.0, "box_iou": 0.8}


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """A saved map with its errors."""
    folder = tmp_path_factory.mktemp("map") / "map"
    ObjectMap("room", (mapped(1, other=other()), mapped(2, 1), failed()), UP).save(folder)
    (folder / "evaluation.json").write_text(json.dumps({"scene": "room", "objects": [{"id": 1, **ERRORS}]}))
    return folder


def show(folder: Path) -> None:
    map_contents(folder, None, None, {})


@fuzzed
@given(data=st.data())
def test_a_document_with_other_values(good, data):
    document = json.loads((good / "map.json").read_text())
    with replaced(good, good / "map.json", encoded(data.draw(changed(document)))):
        attempt(show, good)


@fuzzed
@given(data=st.data())
def test_a_damaged_file(good, data):
    path = data.draw(st.sampled_from(files_in(good)))
    with replaced(good, path, data.draw(damaged(path))):
        attempt(show, good)
