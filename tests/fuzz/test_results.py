"""What a comparison left: its rows, its settings, and the figures that a suite's page is made of."""

import dataclasses
import json
import shutil
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from objgraph.bench.comparison.objects.rows import ObjectRow
from objgraph.bench.comparison.running.store import complete, digest
from objgraph.cli.evaluate_command import FIGURES
from objgraph.cli.suite import render
from tests.fuzz.inputs import attempt, fuzzed
from tests.fuzz.strategies import changed, damaged, encoded
from tests.objgraph.bench.test_comparison_report import made_up
from tests.objgraph.cli.test_suite import document

SETTINGS = {"seed": 0, "solver": {"steps": 3}}
FIGURES_OF_A_PART = encoded(document())
ROWS = [dataclasses.replace(row, settings=digest(SETTINGS)) for row in made_up()[:3]]


def fresh(factory, name: str) -> Path:
    folder = factory.getbasetemp() / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


def go_on(folder: Path) -> None:
    """As a run that was stopped, and that has nothing left to do."""
    groups = {row.group: SETTINGS for row in ROWS}
    complete(folder / "objects.jsonl", ObjectRow, [], groups, lambda missing: [])


def run_folder(factory) -> Path:
    folder = fresh(factory, "rows")
    lines = [json.dumps(dataclasses.asdict(row)) + "\n" for row in ROWS]
    (folder / "objects.jsonl").write_text("".join(lines))
    (folder / "settings.json").write_text(json.dumps({digest(SETTINGS): SETTINGS}))
    return folder


@fuzzed
@given(data=st.data())
def test_a_run_whose_files_are_damaged(tmp_path_factory, data):
    folder = run_folder(tmp_path_factory)
    path = data.draw(st.sampled_from([folder / "objects.jsonl", folder / "settings.json"]))
    content = data.draw(damaged(path)) or b""
    path.write_bytes(content)
    attempt(go_on, folder)


@fuzzed
@given(data=st.data())
def test_a_row_of_other_values(tmp_path_factory, data):
    folder = run_folder(tmp_path_factory)
    first, *rest = (folder / "objects.jsonl").read_bytes().splitlines(keepends=True)
    row = encoded(data.draw(changed(json.loads(first)))) + b"\n"
    (folder / "objects.jsonl").write_bytes(b"".join([row, first, *rest]))
    attempt(go_on, folder)


@fuzzed
@given(data=st.data())
def test_a_page_of_damaged_figures(tmp_path_factory, data):
    folder = fresh(tmp_path_factory, "suite")
    path = folder / "hard-families" / FIGURES
    path.parent.mkdir()
    path.write_bytes(FIGURES_OF_A_PART)
    path.write_bytes(data.draw(damaged(path)) or b"")
    attempt(render, "docs", folder, folder / "docs")
