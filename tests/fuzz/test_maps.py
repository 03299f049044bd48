"""Map files: any change of a good one's."""

import json
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.maps.object_map import ObjectMap
from tests.fuzz.inputs import attempt, fuzzed
from tests.fuzz.strategies import changed, encoded, garbled
from tests.objgraph.maps.map_cases import UP, failed, mapped, other


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """A saved map."""
    folder = tmp_path_factory.mktemp("map") / "map"
    ObjectMap("room", (mapped(1, other=other()), mapped(2, 1), failed()), UP).save(folder)
    return folder


def attempt_file(good: Path, name: str, content: bytes) -> None:
    """Load the map with one of its files in another's place."""
    folder = good.parent / "other"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good, folder)
    (folder / name).write_bytes(content)
    attempt(ObjectMap.load, folder)


@fuzzed
@given(data=st.data())
def test_a_document_with_other_values(good, data):
    document = json.loads((good / "map.json").read_text())
    attempt_file(good, "map.json", encoded(data.draw(changed(document))))


@fuzzed
@given(data=st.data())
def test_a_damaged_file(good, data):
    path = data.draw(st.sampled_from(sorted(good.iterdir())))
    attempt_file(good, path.name, data.draw(garbled(path.read_bytes())))
