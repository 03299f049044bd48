"""Files and folders that appear whole or not at all, and what becomes of what a kill left."""

import multiprocessing
import os
import signal
import threading
from pathlib import Path

import pytest

from objgraph.atomic import UNFINISHED, check_place, new_file, write_file, write_folder
from objgraph.errors import DatasetError, MapError, OutputError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_replaces_another_and_folders_above_are_made(tmp_path):
    path = tmp_path / "a" / "b.txt"
    write_file(path, b"old")
    write_file(path, b"new")
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o644
    assert names(path.parent) == ["b.txt"]


@pytest.mark.parametrize("problem", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_what_fails_leaves_the_old_file_alone(tmp_path, problem):
    path = tmp_path / "b.txt"
    write_file(path, b"old")

    def fail() -> None:
        with new_file(path, MapError) as unfinished:
            unfinished.write_bytes(b"half")
            raise problem

    with pytest.raises(MapError if isinstance(problem, OSError) else KeyboardInterrupt) as told:
        fail()
    if isinstance(problem, OSError):
        assert str(told.value) == f"{path}: cannot be written ([Errno 28] No space left on device)"
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["b.txt"]


def test_a_file_in_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/b\.txt: cannot be written"):
        write_file(tmp_path / "file" / "b.txt", b"")
    with pytest.raises(DatasetError, match="file/b: the folder cannot be written"):
        write_folder(tmp_path / "file" / "b", lambda folder: None)


def test_asking_whether_a_place_can_be_written_changes_nothing(tmp_path):
    (tmp_path / "file").touch()
    before = tmp_path.stat().st_mtime_ns
    check_place(tmp_path / "file")
    check_place(tmp_path / "new" / "below" / "a.txt")
    for path in (tmp_path, tmp_path / "file" / "b.txt", tmp_path / (400 * "9") / "b.txt"):
        with pytest.raises(MapError, match=f"{path}: cannot be written"):
            check_place(path, MapError)
    assert names(tmp_path) == ["file"]
    assert tmp_path.stat().st_mtime_ns == before


def test_the_next_write_removes_what_a_kill_left_and_nothing_else(tmp_path):
    (tmp_path / ".mine.tmp").touch()

    def in_folder(folder: Path) -> None:
        (folder / "half").touch()
        os.kill(os.getpid(), signal.SIGKILL)

    def in_file() -> None:
        with new_file(tmp_path / "a.txt") as unfinished:
            unfinished.write_bytes(b"half")
            os.kill(os.getpid(), signal.SIGKILL)

    for work in (lambda: write_folder(tmp_path / "folder", in_folder), in_file):
        child = multiprocessing.get_context("fork").Process(target=work)
        child.start()
        child.join()
        assert child.exitcode == -signal.SIGKILL
    left = [name for name in names(tmp_path) if name.endswith(UNFINISHED)]
    assert [name.split(".")[1] for name in left] == ["a"]  # the folder went with the file's beginning
    write_file(tmp_path / "b.txt", b"")
    assert names(tmp_path) == [".mine.tmp", "b.txt"]


def test_what_is_still_being_written_is_left_alone(tmp_path):
    with new_file(tmp_path / "a.txt") as unfinished:
        unfinished.write_bytes(b"a")
        write_file(tmp_path / "b.txt", b"b")
        writer = threading.Thread(target=write_file, args=(tmp_path / "a.txt", b"other"))
        writer.start()
        writer.join()
        assert (tmp_path / "a.txt").read_bytes() == b"other"
    assert (tmp_path / "a.txt").read_bytes() == b"a"
    assert names(tmp_path) == ["a.txt", "b.txt"]
