"""Work spread over processes that do not outlive their parent, and whose death is told."""

import logging
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from logging.handlers import QueueHandler
from multiprocessing import active_children, get_context, parent_process
from queue import SimpleQueue
from typing import Literal, TypeVar

from objgraph.errors import ObjectGraphError, ProcessError

log = logging.getLogger(__name__)

Result = TypeVar("Result")


def spread(
    works: Iterable[Callable[[], Result]], jobs: int = 1
) -> Generator[tuple[int, Result | ProcessError], None, None]:
    """What comes of each piece of work, with its place among them, as it is done.

    Each piece has one thread, so that results do not depend on `jobs`. With one job it is done here, when it is asked
    for; with more it is pickled to one of so many processes, and what it logs there is logged here. A process that dies
    costs the piece that it was at, whose result is the error, and no other.
    """
    if jobs == 1:
        for place, work in enumerate(works):
            with threads(1):
                result = work()
            yield place, result
        return
    left: dict[int, Callable[[], Result]] = {}
    yield from _in_processes(enumerate(works), jobs, left)
    if left:
        log.warning("a process died, perhaps for want of memory: what is left is done one at a time")
    while left:  # so the piece that a process dies at is known
        yield from _in_processes(list(left.items()), 1, left)
        if left:
            place = next(iter(left))
            del left[place]
            yield place, ProcessError("its process died, perhaps for want of memory; fewer --jobs need less")


def _in_processes(
    pieces: Iterable[tuple[int, Callable[[], Result]]], jobs: int, left: dict[int, Callable[[], Result]]
) -> Iterator[tuple[int, Result]]:
    """Results of the pieces; those that a process's death has left undone stay in `left`."""
    level = logging.getLogger("objgraph").getEffectiveLevel()
    with process_pool(jobs, ProcessError, begin=partial(_listen, level)) as pool:
        places: dict[Future[tuple[Result, list[logging.LogRecord]]], int] = {}
        for place, work in pieces:
            left[place] = work
            try:
                places[pool.submit(_heard, work)] = place
            except BrokenProcessPool:
                continue
        for future in as_completed(places):
            if isinstance(future.exception(), BrokenProcessPool):
                continue
            result, records = future.result()
            for record in records:
                logging.getLogger(record.name).handle(record)
            del left[places[future]]
            yield places[future], result


_TOLD: SimpleQueue[logging.LogRecord] = SimpleQueue()
"""What a pool's process has logged since it was last heard."""


def _listen(level: int) -> None:
    logging.getLogger().handlers = [QueueHandler(_TOLD)]
    logging.getLogger().setLevel(level)


def _heard(work: Callable[[], Result]) -> tuple[Result, list[logging.LogRecord]]:
    result, records = work(), []
    while not _TOLD.empty():
        records.append(_TOLD.get())
    return result, records


@contextmanager
def threads(count: int) -> Iterator[None]:
    """So many of torch's threads for a while."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def process_pool(
    jobs: int,
    error: type[ObjectGraphError],
    start: Literal["spawn", "fork"] = "spawn",
    begin: Callable[[], None] | None = None,
) -> Iterator[ProcessPoolExecutor]:
    """A pool of single-threaded processes; stopped (by Ctrl-C, or by an error) it does not wait for what is in progress.

    `begin` is called first in each; what it holds is not sent to forked ones.

    Raises:
        error: a process died.
    """
    others = set(active_children())
    pool = ProcessPoolExecutor(jobs, get_context(start), _begin, (begin,))
    try:
        yield pool
    except BaseException as problem:
        for worker in set(active_children()) - others:
            worker.terminate()
        if isinstance(problem, BrokenProcessPool):
            raise error(
                "a process died, perhaps for want of memory: the same command goes on from here, with fewer --jobs it "
                "needs less"
            ) from problem
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(further: Callable[[], None] | None) -> None:
    begin_worker()
    if further is not None:
        further()


def begin_worker() -> None:
    """What a pool's process does first."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent sees to it
    torch.set_num_threads(1)
    # a pool's processes would go on for ever after a parent that was killed
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)
