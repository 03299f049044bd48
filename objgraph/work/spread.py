"""Work spread over whoever is there to do it."""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Literal, TypeVar

from factors import checks
from objgraph.errors import ConfigError, ProcessError
from objgraph.work.processes import spread_over_processes
from objgraph.work.ray_cluster import spread_by_ray
from objgraph.work.worker import threads

Result = TypeVar("Result")
Engine = Literal["local", "ray"]
"""Processes of this machine, or the workers of a Ray cluster (`objgraph.work.ray_cluster`)."""


@dataclass(frozen=True)
class Workers:
    """Who does work that is spread."""

    jobs: int = 1
    """Processes; of a Ray cluster that runs already its own CPUs count."""
    engine: Engine = "local"

    def __post_init__(self) -> None:
        """Raises ConfigError where `jobs` is no positive whole number, or there is no such engine."""
        checks.settings(self, ConfigError, jobs=checks.Range(1))

    @property
    def is_here(self) -> bool:
        """Whether it is this process alone."""
        return self.engine == "local" and self.jobs == 1


HERE = Workers()


def spread(
    works: Iterable[Callable[[], Result]], workers: Workers = HERE
) -> Generator[tuple[int, Result | ProcessError], None, None]:
    """What comes of each piece of work, with its place among them, as it is done.

    Each piece has one thread, so that results do not depend on the workers. With one job it is done here, when it is
    asked for; with more it is pickled to one of so many processes, and what it logs there is logged here. A process that
    dies costs the piece that it was at, whose result is the error, and no other; so does a result that cannot be pickled,
    or an error that cannot. Any other error of the work is raised here, and ends the rest.

    Raises:
        ProcessError: there is no Ray cluster.
    """
    if workers.engine == "ray":
        yield from spread_by_ray(works, workers.jobs)
    elif workers.jobs > 1:
        yield from spread_over_processes(works, workers.jobs)
    else:
        for place, work in enumerate(works):
            with threads(1):
                result = work()
            yield place, result
