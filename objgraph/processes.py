"""Pools of processes that do not outlive their parent, and whose death is told."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from typing import Literal

from objgraph.errors import ObjectGraphError


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


def begin_worker(threads: int = 1) -> None:
    """What a pool's process does first."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent sees to it
    torch.set_num_threads(threads)
    # a pool's processes would go on for ever after a parent that was killed
    threading.Thread(target=_end_with_parent, daemon=True).start()


def threads_each(jobs: int) -> int:
    """Torch's threads in each of so many processes that share them; `OMP_NUM_THREADS` bounds them."""
    import torch

    return max(1, torch.get_num_threads() // jobs)


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)
