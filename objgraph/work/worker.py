"""What a process does that works for another."""

import ctypes
import logging
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging.handlers import QueueHandler
from multiprocessing import parent_process
from queue import SimpleQueue
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from objgraph.errors import ProcessError

Result = TypeVar("Result")

_TOLD: SimpleQueue[logging.LogRecord] = SimpleQueue()
"""What a pool's process has logged since it was last heard."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Of glibc's malloc.h: how much free memory is given back, and how large a piece is asked of the system alone."""


def listen(level: int) -> None:
    """Keep what is logged here for `heard`, and log nothing otherwise."""
    logging.getLogger().handlers = [QueueHandler(_TOLD)]
    logging.getLogger().setLevel(level)


def heard(
    work: Callable[[], object], dumps: Callable[[object], bytes] = pickle.dumps
) -> tuple[bytes, list[logging.LogRecord]]:
    """What comes of a piece of work, of one thread, pickled, and what was logged on the way; `received` reads it.

    Pickled here, because what cannot be costs the piece alone here: on the way it would end the pool, or look like a death.
    An error that can be pickled is raised; of another, as of such a result, comes a ProcessError that names it.
    """
    try:
        with threads(1):
            result = work()
    except Exception as error:
        if _travels(error, dumps):
            raise
        result = ProcessError(_in_words(error))
    try:
        data = dumps(result)
    except Exception as error:  # whatever the result's own methods raise
        data = dumps(ProcessError(f"its result cannot be pickled ({_in_words(error)})"))
    records = []
    while not _TOLD.empty():
        records.append(_TOLD.get())
    return data, records


def received(data: bytes, records: list[logging.LogRecord]) -> Any:
    """What `heard` gives, unpickled and logged here."""
    for record in records:
        logging.getLogger(record.name).handle(record)
    try:
        return pickle.loads(data)
    except Exception as error:
        return ProcessError(f"its result cannot be unpickled ({_in_words(error)})")


def _travels(error: Exception, dumps: Callable[[object], bytes]) -> bool:
    try:
        pickle.loads(dumps(error))
    except Exception:  # whatever the error's own methods raise: then its words are sent
        return False
    return True


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


@contextmanager
def threads(count: int) -> Iterator[None]:
    """So many of torch's threads, and of the other libraries', for a while."""
    with torch_threads(count), threadpool_limits(count, "blas"):  # numpy's and scipy's fight over cores
        yield


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """So many of torch's threads for a while; those of the process's other threads stay."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def keep_memory() -> None:
    """Have this process keep what it frees, where its C library can: a solver asks for the same megabytes again and again, and the
    system clears each page of them anew."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, 128 * 2**20)
        mallopt(_MMAP_THRESHOLD, 32 * 2**20)


def begin_worker() -> None:
    """What a pool's process does first."""
    import torch

    keep_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent sees to it
    torch.set_num_threads(1)
    threadpool_limits(1, "blas")
    # a pool's processes would go on for ever after a parent that was killed
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)
