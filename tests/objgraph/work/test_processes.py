"""Pools whose processes' death is told, and which do not wait for what nobody wants any more."""

import logging
import os
import re
import time
from functools import partial
from multiprocessing import active_children, get_context

import pytest
import torch

from objgraph.errors import ConfigError, PriorError, ProcessError
from objgraph.work import Workers, in_order, process_pool, spread


def worked(what: str) -> str:
    if what == "die":
        os._exit(3)
    if what == "wait":
        time.sleep(600)
    if what == "fail":
        raise ValueError("mistake")
    return what


class TwoWords(Exception):
    """Is pickled, but not unpickled: its constructor is called with one argument then."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} {other}")


def awkward(what: str) -> object:
    """What a process cannot send."""
    if what == "error":
        raise TwoWords("disk", "full")
    return (lambda: what) if what == "result" else [TwoWords("an", "entry")]


AWKWARD = {
    "error": r"^TwoWords: disk full$",
    "result": "its result cannot be pickled .*lambda",
    "entry": "its result cannot be unpickled .*TwoWords",
}


def told(i: int) -> tuple[int, int]:
    logging.getLogger("objgraph.told").info("piece %d", i)
    return 10 * i, torch.get_num_threads()


@pytest.mark.parametrize("start", ["copy", "fork"])
def test_a_process_that_dies_is_told_in_a_line(start):
    def work() -> None:
        with process_pool(1, PriorError, start) as pool:
            list(pool.map(worked, ["a", "die", "b"]))

    with pytest.raises(PriorError, match="a process died"):
        work()
    assert not active_children()


def test_a_mistake_does_not_wait_for_what_is_in_progress():
    def fail() -> None:
        with process_pool(1, PriorError, "fork") as pool:
            pool.submit(worked, "wait")
            raise ValueError("mistake")

    with pytest.raises(ValueError, match="mistake"):
        fail()
    assert not active_children()


@pytest.mark.parametrize("jobs", [1, 2])
def test_work_is_the_same_in_however_many_processes(jobs, caplog):
    before = torch.get_num_threads()
    with caplog.at_level(logging.INFO, "objgraph"):
        found = dict(spread((partial(told, i) for i in range(5)), Workers(jobs)))
    assert found == {i: (10 * i, 1) for i in range(5)}  # one thread each
    assert torch.get_num_threads() == before
    assert {r.getMessage() for r in caplog.records if r.name == "objgraph.told"} == {
        f"piece {i}" for i in range(5)
    }
    assert not active_children()


def test_a_process_that_dies_costs_its_piece_alone(caplog):
    found = dict(spread([partial(worked, what) for what in ["a", "die", "b", "die", "c"]], Workers(2)))
    assert {place: what for place, what in found.items() if isinstance(what, str)} == {0: "a", 2: "b", 4: "c"}
    assert all(isinstance(found[place], ProcessError) for place in (1, 3))
    assert len(found) == 5
    assert "a process died" in caplog.text


@pytest.mark.parametrize("what", AWKWARD)
def test_what_a_process_cannot_send_costs_its_piece_alone_and_is_named(what, caplog):
    works = [partial(worked, "a"), partial(awkward, what), partial(worked, "b")]
    found = dict(spread(works, Workers(2)))
    assert (found[0], found[2]) == ("a", "b")
    assert isinstance(found[1], ProcessError)
    assert re.search(AWKWARD[what], str(found[1]))
    assert "died" not in caplog.text


@pytest.mark.parametrize("start", ["copy", "fork"])
def test_a_pool_s_results_come_in_their_order_with_what_was_logged(start, caplog):
    with caplog.at_level(logging.INFO, "objgraph"), process_pool(1, PriorError, start) as pool:
        found = list(in_order(pool, (partial(told, i) for i in range(5))))
    assert found == [(10 * i, 1) for i in range(5)]
    assert [r.getMessage() for r in caplog.records if r.name == "objgraph.told"] == [
        f"piece {i}" for i in range(5)
    ]


@pytest.mark.parametrize("what", AWKWARD)
def test_what_a_pool_s_process_cannot_send_is_no_death(what):
    def work() -> None:
        with process_pool(1, PriorError, "fork") as pool:
            list(in_order(pool, [partial(worked, "a"), partial(awkward, what)]))

    with pytest.raises(ProcessError, match=AWKWARD[what]):
        work()
    assert not active_children()


def test_an_error_in_a_process_is_raised_here_and_ends_the_others():
    works = [partial(worked, "wait"), partial(worked, "fail")]
    with pytest.raises(ValueError, match="mistake"):
        dict(spread(works, Workers(2)))
    assert not active_children()


def test_work_that_nobody_wants_any_more_is_left():
    found = spread([partial(worked, "a"), partial(worked, "wait")], Workers(2))
    assert next(found) == (0, "a")
    found.close()
    assert not active_children()


@pytest.mark.parametrize("end", ["left", "mistake"])
def test_a_pool_that_is_stopped_ends_its_own_processes_alone(end):
    stopped = spread([partial(worked, "a"), partial(worked, "wait")], Workers(2))
    assert next(stopped) == (0, "a")
    own = get_context("fork").Process(target=time.sleep, args=(600,))
    own.start()
    with process_pool(1, ProcessError) as other:
        work = other.submit(time.sleep, 1)
        if end == "left":
            stopped.close()
        else:
            with pytest.raises(KeyboardInterrupt):
                stopped.throw(KeyboardInterrupt)
        work.result()  # of a pool that is not stopped
    assert own.is_alive()
    own.kill()
    own.join()
    assert not active_children()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ((1, "Ray"), "Workers.engine must be one of local, ray, not 'Ray'"),
        ((2, None), "Workers.engine must be one of local, ray"),
        ((0,), "Workers.jobs must be at least 1"),
        (("2",), "Workers.jobs must be a whole number"),
    ],
)
def test_workers_that_are_none_are_told(more, words):
    with pytest.raises(ConfigError, match=words):
        Workers(*more)
