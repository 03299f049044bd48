"""What is asked of every input: it is taken, or refused by a typed error that says what is wrong."""

import os
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, settings

from objgraph.errors import ObjectGraphError

MANY = int(os.environ.get("FUZZ", "0"))
"""Inputs of each test of `make fuzz`; without it the same few every time."""
LONGEST = 10.0
"""Seconds that an input may take."""
LARGEST = 4e9
"""Bytes that the process may have had."""
tried = 0

fuzzed = settings(
    max_examples=MANY or 15,
    derandomize=not MANY,
    database=None,
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)
"""Of a test with `hypothesis.given`: its number of inputs."""


class Hang(BaseException):
    """An input took too long; no handler of the project's may take it for an error of its own."""


def attempt(function: Callable[..., Any], *args: Any, **kwargs: Any) -> ObjectGraphError | None:
    """Call with an input that may be wrong; the typed error where there was one.

    Any other exception, a refusal without words, a hang or too much memory fails the test.
    """
    global tried
    tried += 1
    before = signal.signal(signal.SIGALRM, _hang)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    refusal, held = None, _most_held()
    try:
        function(*args, **kwargs)
    except ObjectGraphError as error:
        refusal = error
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert _most_held() < max(LARGEST, held + 1)  # what ran before may have held more
    assert refusal is None or len(str(refusal)) > 10
    return refusal


def _most_held() -> int:
    """Bytes of memory."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _hang(*_: Any) -> None:
    raise Hang(f"more than {LONGEST} s")


@contextmanager
def replaced(root: Path, path: Path, content: bytes | None) -> Iterator[None]:
    """A file below `root` with another content, or without it, for as long as one input is tried.

    Nothing else in the folder may be written, or come to lie there.
    """
    good = path.read_bytes()
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)
    before = _listed(root)
    try:
        yield
        assert _listed(root) == before, "reading has changed the folder"
    finally:
        path.write_bytes(good)


def files_in(root: Path) -> list[Path]:
    """All of them, in an order that does not depend on the machine."""
    return sorted(path for path in root.rglob("*") if path.is_file())


def _listed(root: Path) -> list[tuple[str, int, int]]:
    return [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files_in(root)]
