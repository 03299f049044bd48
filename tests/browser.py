"""A headless browser, where there is one: pages are checked without it too."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_OPTIONS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",

)  # fmt: skip


@contextmanager
def open_page(path: Path) -> Iterator[Any]:
    """Playwright's page of a file; in the end it must have asked for nothing else and complained of nothing."""
    api = pytest.importorskip("playwright.sync_api", reason="no browser: pip install playwright")
    executable = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, _NAMES)), None)
    if executable is None:
        pytest.skip("no browser: install Chromium, or name it by the variable CHROMIUM")
    problems: list[str] = []
    asked: list[str] = []
    with api.sync_playwright() as playwright:
        page = playwright.chromium.launch(executable_path=executable, args=[*_OPTIONS]).new_page()
        page.set_default_timeout(15_000)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("console", lambda said: problems.append(said.text) if said.type == "error" else None)
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        yield page
    assert not problems
    assert asked == [path.as_uri()]
