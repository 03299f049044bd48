"""Every example runs as its user would run it, on the project's own sample."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example(example: Path, tmp_path: Path):
    run = subprocess.run(
        [sys.executable, str(example), "--out", str(tmp_path / "out"), "--views", "2"],
        cwd=tmp_path, capture_output=True, text=True, timeout=600,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-2000:]
    objects = json.loads((tmp_path / "out" / "map.json").read_text())["objects"]
    assert objects
    assert all(entry["status"] == "mapped" for entry in objects)
    assert (tmp_path / "out" / "map.png").stat().st_size > 10_000


def test_there_are_examples():
    assert EXAMPLES
