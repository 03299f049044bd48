"""Words of every verb that may be wrong: done, told in a line, or a usage error; and nothing half-written."""

import contextlib
import io
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.cli.main import VERBS, main
from objgraph.maps.object_map import ObjectMap
from tests.fuzz.inputs import attempt, fuzzed
from tests.objgraph.maps.map_cases import UP, failed, mapped

WORDS = [
    "", "x", "../x", "-1", "0", "1", "7", "2.5", "1e400", "nan", "-inf", "9" * 400, "x" * 5000, "a,b", "[1, 2]", "{}",
    "None", "True", "ä ö", "--", "-", "chair", "scene0470_00", "graph", "cpu", "cuda:99", "[bold]", "%s",
]  # fmt: skip
PLACES = [
    "{absent}",
    "{folder}",
    "{file}",
    "{json}",
    "{map}",
    "{file}/below",
    "{new}/a/b",
    "{new}.safetensors",
]
# what is given first keeps heavy work from beginning: a place that has no data
FIRST = {
    "map": ["--dataset scannet --root {absent} --out {new}", "--config {json} --out {new}", "--dataset kitti --root {folder} --out {new}"],
    "report": ["{map}", "{absent}", "{folder}"],
    "view": ["{map} --save {new}.rrd", "{absent} --save {new}.rrd"],
    "next-view": ["{map} --out {new}", "{absent}", "{map} --cameras {file}"],
    "evaluate": ["--dataset scannet --root {absent} --out {new}", "--dataset kitti --root {folder} --json {new}.json"],
    "calibrate": ["{absent} --out {new}.json", "{folder} --out {new}.json", "--out {new}.json", "{folder} --keep {file} --out {new}.json"],
    "train": ["--category nothing --meshes {absent} --out {new}"],
    "train-guess": ["--prior {absent} --out {new}.safetensors", "--prior {file} --out {new}.safetensors"],
    "convert-prior": ["--source {folder} --category sofa --out {new}.safetensors", "--source {file} --category sofa --out {new}.safetensors"],
    "priors": ["", "{absent}", "{file} --json {new}.json", "--json {file}/below"],
    "evaluate-prior": ["--category chair --meshes {absent} --json {new}.json", "--category chair --meshes {folder} --json {new}.json"],
    "segment": ["--root {absent}", "--root {folder} --weights {absent}"],
    "sensor": ["--root {absent} --out {new}.json", "--root {folder} --out {new}.json", "--dataset kitti --root {folder} --out {new}.json"],
    "bench": ["--parts nothing --json {new}.json", "--parts nothing"],
    "doctor": ["", "--root {folder}", "--root {absent} --out {new}", "--dataset kitti --root {folder} --out {new}"],
}  # fmt: skip
KEPT = {
    "train": {"--meshes", "--category"},
    "evaluate": {"--dataset", "--root"},
    "map": {"--dataset"},
    "bench": {"--parts"},
}
"""Options that would begin hours of work if another word came after them."""


def ran(words: list[str]) -> tuple[int, str]:
    """The exit code, and what was said of what is wrong."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    return code, err.getvalue() or out.getvalue()


@cache
def options(verb: str) -> tuple[str, ...]:
    """Those that its whole help names."""
    _, said = ran([verb, "--help-all"])
    found = sorted(set(re.findall(r"(?<![\w-])--[a-z][\w.-]*", said)) - {"--help", "--help-all"})
    return tuple(each for each in found if each not in KEPT.get(verb, ())) or ("--nothing",)


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("cli")
    (root / "folder").mkdir()
    (root / "file.txt").write_bytes(b"nothing of use\x00\xff")
    (root / "some.json").write_text('{"dataset": "scannet", "settings": {"views": -1}}')
    ObjectMap("room", (mapped(1), failed()), UP).save(root / "map")
    names = {"absent": "absent", "folder": "folder", "file": "file.txt", "json": "some.json", "map": "map"}
    return {name: str(root / file) for name, file in names.items()} | {"new": str(root / "new")}


@pytest.fixture(scope="module")
def here(places) -> Iterator[Path]:
    """The folder of all places, in which the command is typed."""
    root = Path(places["folder"]).parent
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        yield root


def files(root: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


@pytest.mark.parametrize("verb", VERBS)
@fuzzed
@given(data=st.data())
def test_words_of(verb, places, here, data):
    first = data.draw(st.sampled_from(FIRST[verb])).split()
    more = data.draw(
        st.lists(
            st.tuples(
                st.sampled_from(options(verb)),
                st.lists(st.sampled_from([*PLACES, *WORDS]), max_size=2),
            ),
            max_size=3,
        )
    )
    words = [verb, *first, *(word for option, values in more for word in (option, *values))]
    words = [re.sub(r"\{(\w+)\}", lambda m: places[m[1]], word) for word in words]
    before, found = files(here), []
    attempt(lambda: found.append(ran(words)))
    (code, said), after = found[0], files(here)
    assert code in (0, 1, 2), words
    assert "Traceback" not in said
    if code:
        assert said.strip(), words
        assert before == after, sorted(set(before) ^ set(after))
    else:
        assert not [name for name in set(after) - set(before) if "/." in name or name.endswith("tmp")]
