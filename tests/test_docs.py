"""The documentation: its links lead somewhere, its Python compiles, its commands are taken, its pages are short."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
from rich.console import Console

from objgraph.priors.registry import available_priors, prior_for
from tests.conftest import REPOSITORY

command_line = importlib.import_module("objgraph.cli.main")
DOCS = REPOSITORY / "docs"
PAGES = sorted({REPOSITORY / "README.md", *DOCS.rglob("*.md")} - {*(DOCS / "reference" / "made").glob("*")})
"""All but what the site's builder makes of docstrings, helps and examples."""
DATED = {DOCS / "results.md", *(DOCS / "results").iterdir(), *(DOCS / "decisions").iterdir()}
"""What was run is told there, with the options of then, at whatever length it takes."""
GUIDES = [page for page in PAGES if page not in DATED]


def of(page: Path) -> str:
    return str(page.relative_to(REPOSITORY))


@pytest.mark.parametrize("page", PAGES, ids=of)
def test_relative_links_lead_to_files(page: Path):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=of)
def test_python_blocks_compile(page: Path):
    for block in python_of(page):
        compile(block, str(page), "exec")


def test_what_pages_say_of_the_shipped_priors():
    solver, slam = ((DOCS / page).read_text() for page in ("reference/solver.md", "guides/slam.md"))
    priors = [prior_for(category) for category in available_priors()]
    temperatures = {prior.category: prior.guess and prior.guess.config.temperature for prior in priors}
    assert "and, for beds and cars, 5 until" in solver
    assert {category for category, t in temperatures.items() if t == 5} == {"bed", "car"}
    assert {t for category, t in temperatures.items() if category not in ("bed", "car")} == {30}
    assert "only the priors of chairs' and tables' codes, which are of several kinds" in slam
    assert {prior.category for prior in priors if prior.kinds is not None} == {"chair", "table"}


@pytest.mark.parametrize("page", GUIDES, ids=of)
def test_pages_are_short(page: Path):
    assert len(page.read_text().split()) <= 1500


class Taken(Exception):
    """The command's words are what the verb takes."""


@pytest.fixture
def only_parsed(monkeypatch):
    parse = command_line._parsed

    def only_parse(kind, verb, arguments):
        parse(kind, verb, arguments)
        raise Taken

    monkeypatch.setattr(command_line, "_parsed", only_parse)


@pytest.mark.parametrize("page", GUIDES, ids=of)
def test_commands_of_pages_are_taken(page: Path, only_parsed):
    for words in commands_of(page.read_text()):
        with pytest.raises(Taken):
            command_line.VERBS[words[0]](words[1:], Console())


@pytest.mark.parametrize("verb", command_line.VERBS)
def test_examples_of_helps_are_taken(verb: str, only_parsed):
    examples = commands_of(command_line.VERBS[verb].__doc__)
    assert examples
    for words in examples:
        assert words[0] == verb
        with pytest.raises(Taken):
            command_line.VERBS[verb](words[1:], Console())


def test_the_first_page_is_short_and_its_python_runs(tmp_path, monkeypatch):
    text = (REPOSITORY / "README.md").read_text()
    (block,) = python_of(REPOSITORY / "README.md")
    assert len(re.sub(r"```python\n(.*?)```", "", text, flags=re.DOTALL).split()) < 450
    monkeypatch.chdir(tmp_path)
    found: dict = {}
    exec(compile(block, "README.md", "exec"), found)
    assert found["marginals"].matrix.shape == (73, 73)
    truth = found["scan"].ground_truth[2]
    assert found["state"].T_world_object.translation() == pytest.approx(truth.T_world_object[:3, 3], abs=0.15)


def test_the_first_steps_python_runs(tmp_path, monkeypatch, capsys):
    (block,) = python_of(DOCS / "start.md")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "start.md", "exec"), {})
    assert "R:" in capsys.readouterr().out


def python_of(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)


def commands_of(text: str) -> list[list[str]]:
    """The words after `objgraph` of every command that stands on an indented line of its own."""
    found = r"^ {4}(?:\$ |\.venv/bin/)?objgraph (.+)$"
    lines = re.findall(found, text.replace("\\\n", " "), flags=re.MULTILINE)
    return [shlex.split(re.sub(r"\[[^\]]*\]", " ", line), comments=True) for line in lines]
