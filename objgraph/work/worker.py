"""What a process does that works for another."""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging.handlers import QueueHandler
from multiprocessing import parent_process
from queue import SimpleQueue
from typing import TypeVar

from threadpoolctl import threadpool_limits

Result = TypeVar("Result")

_TOLD: SimpleQueue[logging.LogRecord] = SimpleQueue()
"""What a pool's process has logged since it was last heard."""


def listen(level: int) -> None:
    """Keep what is logged here for `heard`, and log nothing otherwise."""
    logging.getLogger().handlers = [QueueHandler(_TOLD)]
    logging.getLogger().setLevel(level)


def heard(work: Callable[[], Result]) -> tuple[Result, list[logging.LogRecord]]:
    """What comes of a piece of work, of one thread, and what was logged on the way."""
    records = []
    with threads(1):
        result = work()
    while not _TOLD.empty():
        records.append(_TOLD.get())
    return result, records


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


def begin_worker() -> None:
    """What a pool's process does first."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent sees to it
    torch.set_num_threads(1)
    threadpool_limits(1, "blas")
    # a pool's processes would go on for ever after a parent that was killed
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)
