"""Fixtures that several test modules share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("objgraph", deadline=None)  # machines differ; no test asserts a time
settings.load_profile("objgraph")

TESTS = Path(__file__).resolve().parent
REPOSITORY = TESTS.parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files that run whole scans first: processes that share the tests then end at about the same time."""
    items.sort(key=lambda item: item.path.parent != TESTS)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data sets beside the repository, or the one that OBJGRAPH_DATA names."""
    folder = Path(os.environ.get("OBJGRAPH_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"the real data sets are not here: {folder} (set OBJGRAPH_DATA to their folder)")
    return folder
