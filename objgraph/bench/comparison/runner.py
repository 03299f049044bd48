"""Runs what is not done yet: in this process, each row as it comes, or in several, each job's rows at its end."""

import logging
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Protocol, TypeVar

import torch

from objgraph.errors import EvaluationError

Row = TypeVar("Row", covariant=True)


class Job(Protocol[Row]):
    """Some of the work; it is sent to other processes, so it is small and can be pickled."""

    @property
    def name(self) -> str: ...

    def rows(self) -> Iterator[Row]:
        """What comes of it, as it is done; whatever goes wrong is in the rows."""
        ...


def run(jobs: Sequence[Job[Row]], processes: int = 1) -> Iterator[Row]:
    """The rows of all jobs, in the order in which they are done; each process uses one thread.

    Raises:
        EvaluationError: a process died; the rows of jobs that were done are not lost.
    """
    if processes > 1 and len(jobs) > 1:
        yield from _in_processes(jobs, min(processes, len(jobs)))
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # so that the numbers do not depend on how many processes there are
    try:
        for job in jobs:
            yield from job.rows()
    finally:
        torch.set_num_threads(threads)


def _in_processes(jobs: Sequence[Job[Row]], count: int) -> Iterator[Row]:
    waiting, doing = deque(jobs), dict[Future, str]()
    with ProcessPoolExecutor(count, get_context("spawn"), _quiet) as pool:
        while waiting or doing:
            while waiting and len(doing) < count:  # no more than run, so that it is known what died
                job = waiting.popleft()
                doing[pool.submit(_rows, job)] = job.name
            finished, _ = wait(doing, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    rows = future.result()
                except BrokenProcessPool as error:
                    names = " or ".join(doing.values())
                    raise EvaluationError(
                        f"the process that was at {names} died, perhaps for want of memory: the same command goes on "
                        "from here, with fewer --jobs it needs less"
                    ) from error
                del doing[future]
                yield from rows


def _quiet() -> None:
    """What matters of a process is in its rows; Ctrl-C ends it without a word."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    logging.getLogger().setLevel(logging.ERROR)
    torch.set_num_threads(1)


def _rows(job: Job[Row]) -> list[Row]:
    return [*job.rows()]
