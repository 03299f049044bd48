"""Runs what is not done yet, in this process or in several, and hands over rows as they come."""

from collections.abc import Generator, Iterator, Sequence
from functools import partial
from typing import Protocol, TypeVar

from objgraph.errors import EvaluationError, ProcessError
from objgraph.work import HERE, Workers, spread, threads

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


def run(jobs: Sequence[Job[Row]], workers: Workers = HERE) -> Generator[Row, None, None]:
    """The rows of all jobs, as they are done; of several processes those of a job come together, at its end.

    Each process uses one thread. Stopped (by Ctrl-C, or by closing this) it does not wait for what is in progress.

    Raises:
        EvaluationError: the process of some job died; the rows of all other jobs have been handed over.
    """
    if workers.is_here or len(jobs) < 2:
        for job in jobs:
            with threads(1):
                yield from job.rows()
        return
    died = []
    for place, rows in spread([partial(_rows, job) for job in jobs], workers):
        if isinstance(rows, ProcessError):
            died.append(jobs[place].name)
        else:
            yield from rows
    if died:
        raise EvaluationError(
            f"a process that was at {' and one at '.join(died)} died, perhaps for want of memory: the same command goes on "
            "from here, with fewer --jobs it needs less"
        )


def _rows(job: Job[Row]) -> list[Row]:
    return list(job.rows())
