"""Runs what is not done yet, in this process or in several, and hands over rows as they come."""

import logging
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import active_children, get_context
from typing import Protocol, TypeVar

import torch

from objgraph.errors import EvaluationError
from objgraph.processes import begin_worker

Row = TypeVar("Row")
Made = TypeVar("Made", covariant=True)


class Job(Protocol[Made]):
    """Some of the work; it is sent to other processes, so it is small and can be pickled."""

    @property
    def name(self) -> str:
        """Its own among the jobs."""
        ...

    def rows(self) -> Iterator[Made]:
        """What comes of it, as it is done; whatever goes wrong is in the rows."""
        ...


def run(jobs: Sequence[Job[Row]], processes: int = 1) -> Generator[Row, None, None]:
    """The rows of all jobs, as they are done; of several processes those of a job come together, at its end.

    Each process uses one thread. Stopped (by Ctrl-C, or by closing this) it does not wait for what is in progress.

    Raises:
        EvaluationError: a process died; the rows of the jobs that were done by then have been handed over.
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
    others = set(active_children())
    pool = ProcessPoolExecutor(count, get_context("spawn"), _begin)
    left = {job.name: None for job in jobs}  # in the order in which the pool takes them
    futures: dict[Future[list[Row]], str] = {}
    try:
        with suppress(BrokenProcessPool):  # told below, after the rows of what is done
            for job in jobs:
                futures[pool.submit(_rows, job)] = job.name
        for future in as_completed(futures):
            if not isinstance(future.exception(), BrokenProcessPool):
                yield from future.result()
                del left[futures[future]]
        if left:
            raise _died([*left][:count])
    finally:
        if left:
            for worker in set(active_children()) - others:
                worker.terminate()
        pool.shutdown(cancel_futures=True)


def _died(cases: Sequence[str]) -> EvaluationError:
    return EvaluationError(
        f"a process that was at {' or '.join(cases)} died, perhaps for want of memory: the same command goes on from "
        "here, with fewer --jobs it needs less"
    )


def _begin() -> None:
    logging.getLogger().setLevel(logging.ERROR)  # what matters is in the rows
    begin_worker()


def _rows(job: Job[Row]) -> list[Row]:
    return list(job.rows())
