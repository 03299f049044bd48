"""Runs what is not done yet, in this process or in several, and hands over each row as it comes."""

import logging
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, TypeVar

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
        EvaluationError: a process died; what it had handed over is not lost.
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
    context = get_context("spawn")
    waiting = deque(jobs)
    workers, doing = {}, {}
    try:
        for _ in range(count):
            ours, theirs = context.Pipe()
            worker = context.Process(target=_work, args=(theirs,), daemon=True)
            worker.start()
            theirs.close()
            workers[ours] = worker
            _give(ours, waiting.popleft(), doing)
        while workers:
            for connection in wait(list(workers)):
                assert isinstance(connection, Connection)
                row = _received(connection, doing)
                if row is not None:
                    yield row
                elif waiting:
                    _give(connection, waiting.popleft(), doing)
                else:
                    connection.close()
                    workers.pop(connection).join()
    finally:
        for worker in workers.values():
            worker.terminate()
            worker.join()


def _give(connection: Connection, job: Job, doing: dict[Connection, str]) -> None:
    doing[connection] = job.name
    try:
        connection.send(job)
    except OSError as error:
        raise _died(job.name) from error


def _received(connection: Connection, doing: dict[Connection, str]) -> Any:
    try:
        return connection.recv()
    except (EOFError, OSError) as error:
        raise _died(doing[connection]) from error


def _died(case: str) -> EvaluationError:
    return EvaluationError(
        f"the process that was at {case} died, perhaps for want of memory: the same command goes on from here, "
        "with fewer --jobs it needs less"
    )


def _work(connection: Connection) -> None:
    """Jobs in, rows out, None after the last of each; ends when the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent sees to it
    logging.getLogger().setLevel(logging.ERROR)  # what matters is in the rows
    torch.set_num_threads(1)
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        try:
            for row in job.rows():
                connection.send(row)
            connection.send(None)
        except BrokenPipeError:
            return
