"""The documentation: its links lead somewhere and its Python compiles."""

import re
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

PAGES = sorted([REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_to_files(page: Path):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_blocks_compile(page: Path):
    for block in re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL):
        compile(block, str(page), "exec")


def test_the_first_page_is_short_and_its_python_runs(tmp_path, monkeypatch, capsys):
    text = (REPOSITORY / "README.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(re.sub(r"```python\n(.*?)```", "", text, flags=re.DOTALL).split()) < 450
    monkeypatch.chdir(tmp_path)
    found: dict = {}
    exec(compile(block, "README.md", "exec"), found)
    assert found["marginals"].matrix.shape == (73, 73)
    truth = found["scan"].ground_truth[2]
    assert found["state"].T_world_object.translation() == pytest.approx(truth.T_world_object[:3, 3], abs=0.15)
