"""Without a terminal long work is told in lines; on one it is a bar."""

import io
from itertools import count

import pytest
from rich.console import Console

from objgraph.cli.progress import progress


@pytest.fixture
def lines(monkeypatch):
    """What is printed of steps that take a second each."""
    clock = count()
    monkeypatch.setattr("objgraph.cli.progress.time.perf_counter", lambda: float(next(clock)))

    def printed(steps: list[tuple[str, int, int]]) -> list[str]:
        file = io.StringIO()
        with progress(Console(file=file, width=40)) as tell:
            for step in steps:
                tell(*step)
        return file.getvalue().splitlines()

    return printed


def test_one_line_an_object_as_it_is_done(lines):
    steps = [("mapping chair 1", 0, 2), ("mapped chair 1", 1, 2)]
    steps += [("mapping [red] 2", 1, 2), ("failed [red] 2", 2, 2), ("mapped", 2, 2)]
    assert lines(steps) == ["mapped chair 1: 1 of 2, 1.0 s, 2 s left", "failed [red] 2: 2 of 2, 1.0 s"]


def test_many_small_steps_are_told_at_first_at_last_and_now_and_then(lines):
    steps = [("reading frames", i + 1, 100) for i in range(100)]
    assert lines(steps) == [
        "reading frames: 1 of 100, 1.0 s, 99 s left",
        "reading frames: 31 of 100, 31.0 s, 69 s left",
        "reading frames: 61 of 100, 61.0 s, 39 s left",
        "reading frames: 91 of 100, 91.0 s, 9 s left",
        "reading frames: 100 of 100, 100.0 s",
    ]


def test_the_same_work_again_is_told_from_its_first_step(lines):
    steps = [("mapped", i + 1, 50) for i in range(50)] * 2
    assert lines(steps)[3:] == [
        "mapped: 1 of 50, 1.0 s, 49 s left",
        "mapped: 31 of 50, 31.0 s, 19 s left",
        "mapped: 50 of 50, 50.0 s",
    ]


def test_what_an_earlier_run_has_done_says_nothing_of_the_pace(lines):
    assert lines([("fitted", 90, 100), ("fitted", 91, 100)])[0] == "fitted: 90 of 100, 1.0 s, 10 s left"


def test_on_a_terminal_it_is_a_bar():
    file = io.StringIO()
    console = Console(file=file, width=80, force_terminal=True)
    with progress(console) as tell:
        tell("mapped chair 1", 1, 2)
    assert "━" in file.getvalue()
    assert "1 of 2" not in file.getvalue()


def test_a_name_is_no_markup_on_a_terminal():
    file = io.StringIO()
    with progress(Console(file=file, width=80, force_terminal=True)) as tell:
        tell("mapped box [/old] 1", 1, 2)
        tell("mapped box [old] 1", 2, 2)
    assert "box [old] 1" in file.getvalue()


def test_a_mistake_that_is_found_first_is_told_alone():
    file = io.StringIO()
    with progress(Console(file=file, force_terminal=True)):
        pass
    assert file.getvalue() == ""
