"""Work spread over a Ray cluster: the one that runs, or one of this machine that is started for it."""

import logging
import os
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from types import ModuleType
from typing import Any, TypeVar

from objgraph.errors import ProcessError
from objgraph.work.worker import heard, listen, received

Result = TypeVar("Result")

_RETRIES = 3
"""Of a piece whose worker dies."""


def spread_by_ray(
    works: Iterable[Callable[[], Result]], jobs: int
) -> Generator[tuple[int, Result | ProcessError], None, None]:
    """What `objgraph.work.spread` gives, made by the workers of a Ray cluster, one thread and one CPU a piece.

    The cluster is the one that this process is connected to, that RAY_ADDRESS names, or that runs on this machine;
    where there is none, one with `jobs` CPUs is started and ended. What a worker that dies was at is done again.

    Raises:
        ProcessError: the package is not installed, or the cluster cannot be reached or started.
    """
    ray = _package()
    with _cluster(ray, jobs):
        level = logging.getLogger("objgraph").getEffectiveLevel()
        piece = ray.remote(num_cpus=1, max_retries=_RETRIES)(_piece)
        places: dict[Any, int] = {}
        try:
            for place, work in enumerate(works):
                places[piece.remote(work, level, os.getcwd())] = place
            while places:
                (done, *_), _ = ray.wait(list(places), num_returns=1)
                # out before it is looked at: told to cancel what is done, Ray can take this process down
                place = places.pop(done)
                yield place, _result(ray, done)
        finally:
            for unwanted in places:
                ray.cancel(unwanted, force=True)


def _piece(
    work: Callable[[], Result], level: int, folder: str
) -> tuple[bytes, list[logging.LogRecord]]:  # pragma: no cover - runs in a worker
    listen(level)
    with suppress(OSError):  # of another machine, where relative paths then lead nowhere
        os.chdir(folder)
    return heard(work, _package().cloudpickle.dumps)  # which knows a script's own classes, too


def _result(ray: ModuleType, done: Any) -> Any:
    try:
        return received(*ray.get(done))
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error  # the work's own mistake, as with processes
    except ray.exceptions.RayError as error:
        words = (str(error).strip() or type(error).__name__).splitlines()[0]
        return ProcessError(
            f"no worker could do it in {_RETRIES + 1} tries, perhaps for want of memory: {words}"
        )


def _package() -> ModuleType:
    os.environ.setdefault(
        "RAY_USAGE_STATS_ENABLED", "0"
    )  # nothing is reported to anybody unless the user says so
    try:
        import ray
    except ImportError as error:
        raise ProcessError("the engine 'ray' needs its package: pip install 'objgraph[ray]'") from error
    return ray


def _reached(address: str) -> None:
    """Raise OSError where nobody listens at HOST:PORT: Ray would try for many minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host, int(port)), timeout=10).close()


@contextmanager
def _cluster(ray: ModuleType, jobs: int) -> Iterator[None]:
    if ray.is_initialized():
        yield
        return
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    try:
        _reached(os.environ.get("RAY_ADDRESS", ""))
        try:
            ray.init(address="auto", **quiet)
        except ConnectionError:
            if "RAY_ADDRESS" in os.environ:
                raise
            ray.init(num_cpus=jobs, include_dashboard=False, **quiet)
    except Exception as error:  # Ray's own are of many kinds
        ray.shutdown()
        raise ProcessError(f"no Ray cluster can be reached or started: {error}") from error
    try:
        yield
    finally:
        ray.shutdown()
