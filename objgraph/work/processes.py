"""Processes of this machine that do not outlive their parent, and whose death is told."""

import logging
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import forkserver, get_all_start_methods, get_context
from typing import Literal, TypeVar

from objgraph.errors import ObjectGraphError, ProcessError
from objgraph.work.worker import begin_worker, heard, listen, received

log = logging.getLogger(__name__)

Result = TypeVar("Result")
Start = Literal["copy", "fork"]
"""Copies of a process that has read the libraries, and nothing else, or forks of this one, with all that it holds."""


def prepare(module: str) -> None:
    """Have `module` read, beside what is done here, by the process whose copies later pools are."""
    if _copies() == "forkserver":
        # too late for one that runs: its copies read the module themselves
        forkserver.set_forkserver_preload(["__main__", module])
        forkserver.ensure_running()


def spread_over_processes(
    works: Iterable[Callable[[], Result]], jobs: int
) -> Generator[tuple[int, Result | ProcessError], None, None]:
    """What `objgraph.work.spread` gives, made by so many processes of this machine."""
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
    with process_pool(jobs, ProcessError) as pool:
        places: dict[Future[tuple[bytes, list[logging.LogRecord]]], int] = {}
        for place, work in pieces:
            left[place] = work
            try:
                places[pool.submit(heard, work)] = place
            except BrokenProcessPool:
                continue
        for future in as_completed(places):
            if isinstance(future.exception(), BrokenProcessPool):
                continue
            result = received(*future.result())
            del left[places[future]]
            yield places[future], result


def in_order(pool: ProcessPoolExecutor, works: Iterable[Callable[[], Result]]) -> Iterator[Result]:
    """What a pool makes of each piece of work, in their order; what is logged there is logged here.

    Raises:
        ProcessError: a result cannot be pickled, or an error that cannot be: it is named.
    """
    left = deque(pool.submit(heard, work) for work in works)
    while left:
        result = received(*left.popleft().result())
        if isinstance(result, ProcessError):
            raise result
        yield result


@contextmanager
def process_pool(
    jobs: int,
    error: type[ObjectGraphError],
    start: Start = "copy",
    begin: Callable[[], None] | None = None,
) -> Iterator[ProcessPoolExecutor]:
    """A pool of single-threaded processes; stopped (by Ctrl-C, or by an error) it does not wait for what is in progress.

    `in_order` gives it work. `begin` is called first in each; what it holds is not sent to forked ones.

    Raises:
        error: a process died.
    """
    level = logging.getLogger("objgraph").getEffectiveLevel()
    context = get_context("fork" if start == "fork" else _copies())
    pool = ProcessPoolExecutor(jobs, context, _begin, (level, begin))
    try:
        yield pool
    except BaseException as problem:
        # its own alone, which no public name gives before Python 3.14: the caller has processes too
        for worker in list((pool._processes or {}).values()):
            worker.terminate()
        if isinstance(problem, BrokenProcessPool):
            raise error(
                "a process died, perhaps for want of memory: the same command goes on from here, with fewer --jobs it "
                "needs less"
            ) from problem
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _copies() -> Literal["forkserver", "spawn"]:
    """How processes are begun that hold nothing of this one; not every system copies."""
    return "forkserver" if "forkserver" in get_all_start_methods() else "spawn"


def _begin(level: int, further: Callable[[], None] | None) -> None:
    begin_worker()
    listen(level)
    if further is not None:
        further()
