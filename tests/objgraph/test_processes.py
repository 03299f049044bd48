"""Pools whose processes' death is told, and which do not wait for what nobody wants any more."""

import os
import time
from multiprocessing import active_children

import pytest
import torch

from objgraph.errors import PriorError
from objgraph.processes import process_pool, threads_each


def _work(what: str) -> str:
    if what == "die":
        os._exit(3)
    if what == "wait":
        time.sleep(600)
    return what


@pytest.mark.parametrize("start", ["spawn", "fork"])
def test_a_process_that_dies_is_told_in_a_line(start):
    def work() -> None:
        with process_pool(1, PriorError, start) as pool:
            list(pool.map(_work, ["a", "die", "b"]))

    with pytest.raises(PriorError, match="a process died"):
        work()
    assert not active_children()


def test_a_mistake_does_not_wait_for_what_is_in_progress():
    def fail() -> None:
        with process_pool(1, PriorError, "fork") as pool:
            pool.submit(_work, "wait")
            raise ValueError("mistake")

    with pytest.raises(ValueError, match="mistake"):
        fail()
    assert not active_children()


@pytest.mark.parametrize(("threads", "jobs", "each"), [(8, 1, 8), (8, 3, 2), (1, 1, 1), (1, 4, 1)])
def test_processes_share_the_threads_that_torch_was_given(monkeypatch, threads, jobs, each):
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    assert threads_each(jobs) == each
