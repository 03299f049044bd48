"""Inputs of the commands, and a last word that says how much was tried."""

from pathlib import Path

import pytest

from tests.reliability.children import run_in_child
from tests.reliability.commands import Command, write_inputs


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("given")
    write_inputs(folder)
    return folder


@pytest.fixture(scope="session")
def given_map(given: Path) -> Path:
    """The inputs, and a map of them."""
    ended = run_in_child(Command("map", given), given / "map")
    assert ended.code == 0, ended.said
    return given


def pytest_terminal_summary(terminalreporter) -> None:
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed"):
        for name, value in report.user_properties:
            terminalreporter.write_line(f"{report.nodeid.rpartition('::')[2]}: {name} {value}")
