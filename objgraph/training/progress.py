"""Bars on the terminal for long work of several kinds; lines now and then where there is no terminal."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

Report = Callable[[str, int, int], None]
"""Called with what is done, how much of it, and how much there is; what is after a comma may change on the way."""

_EVERY_S = 60.0
"""Between two lines of one kind of work."""


@contextmanager
def bars(prefix: str = "") -> Iterator[Report]:
    """A bar for each kind of work that is reported, gone when all is done."""
    if not Console().is_terminal:
        yield _lines(prefix)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def report(words: str, done: int, total: int) -> None:
            kind = words.split(",")[0]
            if kind not in tasks:
                tasks[kind] = bar.add_task(prefix + words)
            bar.update(tasks[kind], completed=done, total=total, description=prefix + words)

        yield report


def _lines(prefix: str) -> Report:
    told: dict[str, float] = {}

    def report(words: str, done: int, total: int) -> None:
        kind, now = words.split(",")[0], time.monotonic()
        if done == total or now - told.get(kind, -math.inf) >= _EVERY_S:
            told[kind] = now
            print(f"{prefix}{words}: {done} of {total}", flush=True)

    return report
