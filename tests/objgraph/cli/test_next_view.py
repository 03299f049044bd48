"""`objgraph next-view`: what it refuses, and before which work."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from objgraph.active.cameras import looking_at
from objgraph.cli.next_view import NextViewCommand, run_next_view
from objgraph.errors import ActiveVisionError, ConfigError, OutputError
from tests.objgraph.active.test_next_view import UP, toy_map
from tests.toys import toy_prior


@pytest.fixture
def command(tmp_path, monkeypatch) -> NextViewCommand:
    toy_map(category="box [old]", views=("0",), cameras=about_at(9.0)).save(tmp_path / "map")
    monkeypatch.setattr("objgraph.cli.next_view.load_prior_file", lambda _: toy_prior())
    monkeypatch.setattr("objgraph.active.from_map.prior_for", lambda *_: toy_prior())
    return NextViewCommand(tmp_path / "map", candidates=4, priors=(tmp_path / "toy.safetensors",))


def about_at(distance: float) -> np.ndarray:
    return looking_at(np.array([distance, 0.0, 1.0]), np.zeros(3), UP).matrix()[None]


def test_candidates_that_see_nothing_are_no_next_views(command, caplog):
    console = Console(width=140, record=True)
    with pytest.raises(
        ActiveVisionError, match=r"between 0\.3 and 5 m: change --distance, --cameras or --far"
    ):
        run_next_view(replace(command, distance=8.0), console)
    assert (
        "box [old] 1 counts as never seen: none of the 1 views so far sees it between 0.3 and 5 m"
        in caplog.text
    )
    caplog.clear()
    assert run_next_view(replace(command, distance=8.0, far=12.0), console)[0].total() > 0
    assert "never seen" not in caplog.text
    assert "box [old] 1" in console.export_text()


def test_what_cannot_be_listed_or_written_is_told_before_the_work(command, tmp_path, monkeypatch):
    monkeypatch.setattr("objgraph.cli.next_view.next_views", None)
    for top in (0, -1):
        with pytest.raises(ConfigError, match="--top must be at least 1"):
            run_next_view(replace(command, top=top), Console())
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/next_views\.json: cannot be written"):
        run_next_view(replace(command, out=tmp_path / "file"), Console())
