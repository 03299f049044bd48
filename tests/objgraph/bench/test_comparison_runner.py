"""The runner on jobs without work: rows of all, in one process or several, and what becomes of them when it ends early."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import active_children
from pathlib import Path

import pytest
import torch

from objgraph.bench.comparison.running.runner import run
from objgraph.errors import EvaluationError
from objgraph.work import Workers
from tests.conftest import REPOSITORY


@dataclass(frozen=True)
class Count:
    """Two rows: its name, and the threads and the process that made it."""

    name: str
    fault: str = ""

    def rows(self) -> Iterator[tuple[str, int, int]]:
        for _ in range(2):
            yield self.name, torch.get_num_threads(), os.getpid()
        if self.fault == "dies":
            os._exit(3)
        if self.fault == "waits":
            time.sleep(300)


@dataclass(frozen=True)
class Told:
    """Writes down which process it is in, and waits."""

    name: str
    folder: str

    def rows(self) -> Iterator[str]:
        Path(self.folder, f"{os.getpid()}.pid").touch()
        time.sleep(300)
        yield self.name


@pytest.mark.parametrize("processes", [1, 2])
def test_all_jobs_are_run_with_one_thread_each(processes):
    rows = list(run([Count(name) for name in "abc"], Workers(processes)))
    assert sorted(name for name, *_ in rows) == [*"aabbcc"]
    assert {threads for _, threads, _ in rows} == {1}
    assert (os.getpid() in {process for *_, process in rows}) == (processes == 1)
    assert not active_children()


def test_a_process_that_dies_is_told_after_the_rows_of_all_others():
    jobs = [Count("a"), Count("b", "dies"), Count("c"), Count("d", "dies")]
    rows = []
    with pytest.raises(EvaluationError, match=r"at b and one at d died.*the same command goes on"):
        rows.extend(name for name, *_ in run(jobs, Workers(2)))  # extend keeps what came before the error
    assert sorted(rows) == ["a", "a", "c", "c"]
    assert not active_children()


def test_what_is_in_progress_is_not_waited_for_when_it_is_stopped():
    begun = time.monotonic()
    with closing(run([Count("a"), Count("b", "waits"), Count("c", "waits")], Workers(2))) as rows:
        assert next(rows)[0] == "a"
    assert time.monotonic() - begun < 120
    assert not active_children()


def test_nothing_outlives_a_parent_that_is_killed(tmp_path):
    """Workers tell their processes' numbers in files; the parent cannot clean up."""
    script = (
        "from tests.objgraph.bench.test_comparison_runner import Told\n"
        "from objgraph.bench.comparison.running.runner import run\n"
        "from objgraph.work import Workers\n"
        "if __name__ == '__main__':\n"
        f"    list(run([Told(name, {str(tmp_path)!r}) for name in 'ab'], Workers(2)))\n"
    )
    (tmp_path / "parent.py").write_text(script)
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py")], env={**os.environ, "PYTHONPATH": str(REPOSITORY)}
    )
    try:
        _until(lambda: len([*tmp_path.glob("*.pid")]) == 2)
        workers = [int(path.stem) for path in tmp_path.glob("*.pid")]
    finally:
        parent.kill()
        parent.wait()
    _until(lambda: not any(_runs(worker) for worker in workers))


def _until(holds: Callable[[], bool], tries: int = 1200) -> None:
    for _ in range(tries):
        if holds():
            return
        time.sleep(0.1)
    raise AssertionError("it did not come to be so")


def _runs(process: int) -> bool:
    try:
        return "zombie" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
