"""Where it cannot write, a command says so in a line that names the file, and leaves nothing half-written."""

import os
import re
import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from objgraph.atomic import UNFINISHED
from tests.reliability.children import Ended, run_in_child
from tests.reliability.commands import ARGUMENTS, Command, check_whole, outcome
from tests.reliability.test_kills import KILLS

_ROOMS = (0, 8, 40, 500, 1500)
"""KiB that are left: for nothing, some, or most of what a command writes."""
_QUICK = ("segment",)


@dataclass(frozen=True)
class Limited:
    """A command whose files may be so large, which fails in writing as a full disk does and needs no rights."""

    command: Command
    limit: int

    def __call__(self, out: Path) -> int:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (self.limit, before[1]))
        try:
            return self.command(out)
        finally:  # what measures coverage writes at the end
            resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(params=ARGUMENTS)
def command(request: pytest.FixtureRequest) -> Command:
    if not KILLS and request.param not in _QUICK:
        pytest.skip("takes minutes: make kills runs it")
    return Command(
        request.param, request.getfixturevalue("given_map" if request.param == "report" else "given")
    )


def expected(command: Command, tmp_path: Path) -> dict:
    command.prepare(tmp_path / "whole")
    ended = run_in_child(command, tmp_path / "whole")
    assert ended.code == 0, ended.said
    return outcome(tmp_path / "whole", exact=command.name == "report")


def assert_told(ended: Ended, out: Path, before: set[Path]) -> None:
    """One line, which names a file of the folder; what is there is whole."""
    errors = [line for line in ended.said.splitlines() if "error:" in line or "Error" in line]
    assert ended.code == 1, ended.said
    assert len(errors) == 1, ended.said
    assert re.search(re.escape(str(out)), errors[0]), errors
    assert re.search("cannot be written", errors[0]), errors
    assert "Traceback" not in ended.said
    if out.exists():
        check_whole(out)
        assert before <= set(out.rglob("*"))
        assert not [path for path in out.rglob("*") if UNFINISHED in path.name]


def test_files_that_become_too_large_are_told_and_the_next_run_writes_them(
    command, tmp_path, record_property
):
    if command.name == "train-guess":
        pytest.skip("torch's own shared memory has the same limit")
    whole = expected(command, tmp_path)
    refused = 0
    for limit in (100, 5_000, 50_000, 1_000_000):
        out = tmp_path / f"out-{limit}"
        command.prepare(out)
        before = set(out.rglob("*"))
        ended = run_in_child(Limited(command, limit), out)
        if ended.code != 0:
            assert_told(ended, out, before)
            refused += 1
            again = run_in_child(command, out)
            assert again.code == 0, again.said
        assert outcome(out, exact=command.name == "report") == whole
    assert refused
    record_property("limits refused", refused)


def test_a_full_disk_is_told_and_the_next_run_with_room_succeeds(command, tmp_path, record_property):
    whole = expected(command, tmp_path)
    refused = 0
    for room in _ROOMS:
        with small_disk(tmp_path / f"disk-{room}") as disk:
            out = disk / "out"
            command.prepare(out)
            before = set(out.rglob("*"))
            stat = os.statvfs(disk)
            (disk / "filler").write_bytes(bytes(max(0, stat.f_bavail * stat.f_bsize - 1024 * room)))
            ended = run_in_child(command, out)
            (disk / "filler").unlink()
            if ended.code != 0:
                assert_told(ended, out, before)
                refused += 1
                again = run_in_child(command, out)
                assert again.code == 0, again.said
            assert outcome(out, exact=command.name == "report") == whole
    assert refused
    record_property("full disks refused", refused)


def test_a_folder_that_cannot_be_written_is_told(command, tmp_path):
    with small_disk(tmp_path / "disk") as disk:
        out = disk / "out"
        command.prepare(out)
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        assert_told(run_in_child(command, out), out, set(out.rglob("*")))


def test_a_file_in_place_of_the_folder_is_told(command, tmp_path):
    if command.name in ("report", "segment"):
        pytest.skip("it writes where it reads")
    (tmp_path / "file").touch()
    assert_told(run_in_child(command, tmp_path / "file"), tmp_path / "file", set())


@contextmanager
def small_disk(at: Path) -> Iterator[Path]:
    """A file system of 16 MB in memory."""
    at.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "none", str(at)], capture_output=True)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here ({done.stderr.decode().strip()})")
    try:
        yield at
    finally:
        subprocess.run(["umount", str(at)], check=True)
