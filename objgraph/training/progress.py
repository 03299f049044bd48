"""Bars on the terminal for long work of several kinds."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

Report = Callable[[str, int, int], None]
"""Called with what is done, how much of it, and how much there is; what is after a comma may change on the way."""


@contextmanager
def bars(prefix: str = "") -> Iterator[Report]:
    """A bar for each kind of work that is reported, gone when all is done."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def report(words: str, done: int, total: int) -> None:
            kind = words.split(",")[0]
            if kind not in tasks:
                tasks[kind] = bar.add_task(prefix + words)
            bar.update(tasks[kind], completed=done, total=total, description=prefix + words)

        yield report
