"""Commands in processes of their own, which are killed at a moment of choice; what they import is loaded once."""

import os
import random
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

Run = Callable[[Path], int]
"""A command, by the folder that it writes into; gives the exit code."""
_EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_LONGEST_S = 600.0
_FORKS = get_context("forkserver")
_FORKS.set_forkserver_preload(["tests.reliability.commands"])


@dataclass(frozen=True)
class Moment:
    """When a process ends: before its n-th change of files, or so many seconds after it began."""

    change: int | None = None
    seconds: float | None = None
    by: signal.Signals = signal.SIGKILL

    @classmethod
    def drawn(cls, number: int, whole: "Ended", rng: random.Random) -> "Moment":
        """Changes and seconds in turn, within what an undisturbed run takes; one in five is a Ctrl-C."""
        by = signal.SIGINT if number % 5 == 4 else signal.SIGKILL
        if number % 2:
            return cls(seconds=rng.uniform(0, whole.seconds), by=by)
        return cls(change=rng.randint(1, whole.changes), by=by)


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int | None
    """Minus the signal of one that was killed."""
    said: str
    changes: int
    """Of files, where it came to its end."""
    seconds: float


def run_in_child(run: Run, out: Path, moment: Moment | None = None) -> Ended:
    """Run a command, undisturbed or until the moment; it and all that it started must then end."""
    (ours, theirs), (heard, said) = _FORKS.Pipe(), _FORKS.Pipe(duplex=False)
    child = _FORKS.Process(target=_child, args=(run, out, moment, theirs, said))
    child.start()
    theirs.close()
    said.close()
    words: list[bytes] = []
    listener = threading.Thread(target=_listen, args=(heard, words))
    listener.start()
    changes, begun = 0, time.monotonic()
    with suppress(EOFError):
        ours.recv()
        begun = time.monotonic()
        if moment is not None and moment.seconds is not None:
            child.join(moment.seconds)
            if child.is_alive() and child.pid is not None:
                os.kill(child.pid, moment.by)
        changes = ours.recv()
    child.join(_LONGEST_S)
    seconds = time.monotonic() - begun
    listener.join(_LONGEST_S)
    assert not listener.is_alive(), "a process that it started did not end with it"
    return Ended(child.exitcode, b"".join(words).decode(), changes, seconds)


def _listen(heard: Connection, words: list[bytes]) -> None:
    """What is said, until nobody can say more."""
    while data := os.read(heard.fileno(), 65536):
        words.append(data)


def _child(run: Run, out: Path, moment: Moment | None, pipe: Connection, said: Connection) -> None:
    for number in (1, 2):
        os.dup2(said.fileno(), number)
    said.close()
    counter = _Counter(out, None if moment is None or moment.change is None else moment)
    sys.addaudithook(counter)
    pipe.send(None)
    code = run(out)
    sys.stdout.flush()
    pipe.send(counter.count)
    sys.exit(code)


class _Counter:
    """Counts what the process is about to do to files of a folder, and ends it at the moment."""

    def __init__(self, folder: Path, moment: Moment | None) -> None:
        self.folder, self.moment, self.count, self.process = str(folder), moment, 0, os.getpid()

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event not in _EVENTS or not str(arguments[0]).startswith(self.folder):
            return
        if os.getpid() != self.process or (event == "open" and not arguments[2] & _WRITES):
            return
        self.count += 1
        if self.moment is not None and self.count == self.moment.change:
            os.kill(self.process, self.moment.by)
