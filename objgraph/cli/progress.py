"""Long work: one bar on a terminal that says what is being done, and lines anywhere else."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

Progress = Callable[[str, int, int], None]
"""(what is being done, done, of how many)."""
_PATIENCE = 30.0
"""Seconds between lines on many small steps of one kind."""


@contextmanager
def progress(console: Console, transient: bool = False) -> Iterator[Progress]:
    """A progress bar, a `transient` one gone once the work is done; without a terminal, a line for what is done."""
    if not console.is_terminal:
        yield _Lines(console)
        return
    left = TimeRemainingColumn(elapsed_when_finished=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), left)
    bar = Bar(*columns, console=console, transient=transient)
    task = bar.add_task("starting", total=None)

    def tell(what: str, done: int, total: int) -> None:
        bar.start()  # not before: a mistake that is found first is one line
        bar.update(task, description=what, completed=done, total=total)

    try:
        yield tell
    finally:
        if bar.live.is_started:
            bar.stop()


class _Lines:
    """A line whenever more is done than before: what, how many of how many, its seconds, and those of what is left."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._what = self._printed = ""
        self._done = self._total = 0
        self._told = self._begun = self._printed_at = time.perf_counter()
        self._first = (0, self._told)

    def __call__(self, what: str, done: int, total: int) -> None:
        now = time.perf_counter()
        anew = total != self._total or done < self._done
        if anew or what != self._what:
            self._what, self._begun = what, self._told  # its first step began when the last thing was told
        if anew:
            self._first = (max(done - 1, 0), self._told)  # what an earlier run has done took no time
        stepped = done > (0 if anew else self._done)
        self._done, self._total, self._told = done, total, now
        soon = not anew and what == self._printed and done < total and now - self._printed_at < _PATIENCE
        if not stepped or soon:
            return
        self._printed, self._printed_at = what, now
        line = f"{what}: {done} of {total}, {now - self._begun:.1f} s{self._left()}"
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def _left(self) -> str:
        """At the pace so far, in words."""
        done, since = self._first
        seconds = (self._told - since) / (self._done - done) * (self._total - self._done)
        if seconds < 2:
            return ""
        return f", {seconds:.0f} s left" if seconds < 120 else f", {seconds / 60:.0f} min left"
