"""Work that a Ray cluster does: what comes of it is what one process gives, and a worker that dies loses nothing."""

import logging
import os
import re
import signal
import socket
import sys
from functools import partial
from pathlib import Path

import pytest

from objgraph.bench.comparison.running.runner import run
from objgraph.errors import ProcessError
from objgraph.work import Workers, spread
from tests.objgraph.bench.test_comparison_runner import Count
from tests.objgraph.work.test_processes import AWKWARD, awkward, told, worked

RAY = Workers(2, "ray")


@pytest.fixture(scope="module", autouse=True)
def cluster():
    """One of two CPUs, so that each test need not start its own."""
    ray = pytest.importorskip("ray", reason="the package ray is not installed (pip install 'objgraph[ray]')")
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
    ray.init(num_cpus=2, include_dashboard=False, **quiet)
    yield ray
    ray.shutdown()


def die_once(marker: Path) -> str:
    """Killed as the system kills, the first time."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def test_work_and_what_it_logs_are_as_in_one_process(caplog):
    with caplog.at_level(logging.INFO, "objgraph"):
        found = dict(spread((partial(told, i) for i in range(5)), RAY))
    assert found == {i: (10 * i, 1) for i in range(5)}  # one thread each
    assert sorted(r.getMessage() for r in caplog.records if r.name == "objgraph.told") == [
        f"piece {i}" for i in range(5)
    ]


def test_what_a_killed_worker_was_at_is_done_again(tmp_path):
    works = [partial(worked, "a"), partial(die_once, tmp_path / "marker"), partial(worked, "b")]
    assert dict(spread(works, RAY)) == {0: "a", 1: "done", 2: "b"}


def test_a_piece_that_kills_every_worker_costs_itself_alone():
    found = dict(spread([partial(worked, what) for what in ("a", "die", "b")], RAY))
    assert (found[0], found[2]) == ("a", "b")
    assert isinstance(found[1], ProcessError)
    assert "in 4 tries" in str(found[1])


@pytest.mark.parametrize("what", ["error", "entry"])  # Ray sends a lambda
def test_what_a_worker_cannot_send_costs_its_piece_alone_and_is_named(what):
    found = dict(spread([partial(worked, "a"), partial(awkward, what), partial(worked, "b")], RAY))
    assert (found[0], found[2]) == ("a", "b")
    assert isinstance(found[1], ProcessError)
    assert re.search(AWKWARD[what], str(found[1]))


def test_a_mistake_is_raised_here_and_ends_the_others(cluster, monkeypatch):
    cancel, ended = cluster.cancel, []
    monkeypatch.setattr(cluster, "cancel", lambda task, **how: (ended.append(task), cancel(task, **how)))
    with pytest.raises(ValueError, match="mistake"):
        dict(spread([partial(worked, "wait"), partial(worked, "fail")], RAY))
    assert len(ended) == 1  # not what is done: Ray aborts where it is told so before it has noted its end
    assert cluster.is_initialized()  # the user's own cluster stays


def test_rows_of_a_comparison_are_those_of_one_process():
    found = [name for name, *_ in run([Count(name) for name in "abc"], RAY)]
    assert sorted(found) == sorted(name for name, *_ in run([Count(name) for name in "abc"]))


def test_without_the_package_a_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ProcessError, match=r"pip install 'objgraph\[ray\]'"):
        list(spread([partial(worked, "a")], RAY))


def test_a_cluster_that_is_not_there_is_told_at_once(cluster, monkeypatch):
    monkeypatch.setattr(cluster, "is_initialized", lambda: False)
    monkeypatch.setattr(cluster, "shutdown", lambda: None)  # of the one that other tests use
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{unused.getsockname()[1]}")
        with pytest.raises(ProcessError, match="no Ray cluster can be reached"):
            list(spread([partial(worked, "a")], RAY))
