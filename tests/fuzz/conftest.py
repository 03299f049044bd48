"""Counts what was tried; `make fuzz` ends with the numbers."""

from typing import Any

import pytest

from tests.fuzz import inputs

_of_workers: list[int] = []
_failed: set[str] = set()


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["tried"] = inputs.tried  # type: ignore[attr-defined]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    _of_workers.append(getattr(node, "workeroutput", {}).get("tried", 0))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        _failed.add(report.nodeid)


def pytest_unconfigure(config: pytest.Config) -> None:
    if inputs.MANY and not hasattr(config, "workerinput"):
        print(f"inputs {inputs.tried + sum(_of_workers)} crashes {len(_failed)}")
