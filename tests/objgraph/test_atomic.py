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
    (tmp_path / "plain").touch()  # of whatever mode the process gives
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode
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


@pytest.fixture
def umask_077():
    before = os.umask(0o077)
    yield
    os.umask(before)


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


@pytest.mark.usefixtures("umask_077")
def test_what_is_new_has_the_process_s_mode_and_what_replaces_the_old_one_s(tmp_path):
    write_file(tmp_path / "new", b"")
    write_folder(tmp_path / "folder", lambda folder: None)
    assert (mode(tmp_path / "new"), mode(tmp_path / "folder")) == (0o600, 0o700)
    for due in (0o640, 0o444):
        (tmp_path / "new").chmod(due)
        with new_file(tmp_path / "new") as unfinished:
            assert mode(unfinished) == 0o600  # nobody reads what is half done
        assert mode(tmp_path / "new") == due
    (tmp_path / "folder").chmod(0o755)
    write_folder(tmp_path / "folder", lambda folder: None)
    assert mode(tmp_path / "folder") == 0o755


@pytest.mark.parametrize("there", [True, False])
def test_what_a_link_leads_to_is_written_and_the_link_stays(tmp_path, there):
    target, link = tmp_path / "disk" / "target", tmp_path / "link"
    if there:
        target.parent.mkdir()
        target.write_bytes(b"old")
    link.symlink_to(target)
    check_place(link)
    write_file(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    folder = tmp_path / "masks"
    folder.symlink_to(tmp_path / "big" / "masks")
    if there:
        folder.resolve().mkdir(parents=True)
    assert write_folder(folder, lambda unfinished: (unfinished / "a").touch()) == folder
    assert folder.is_symlink()
    assert names(folder) == ["a"]
    assert names(tmp_path / "big") == ["masks"]


def test_below_a_link_that_leads_nowhere_folders_are_made_where_it_leads(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    check_place(tmp_path / "link" / "a.txt")
    write_file(tmp_path / "link" / "a.txt", b"a")
    assert (tmp_path / "nowhere" / "a.txt").read_bytes() == b"a"


@pytest.mark.parametrize("letter", ["a", "\N{GREEK SMALL LETTER PI}"])
def test_a_name_may_be_as_long_as_the_file_system_lets_it(tmp_path, letter):
    path = tmp_path / (letter * (255 // len(letter.encode())))
    check_place(path)
    write_file(path, b"a")
    path.unlink()
    write_folder(path, lambda folder: None)
    assert path.is_dir()


def test_a_folder_that_cannot_be_replaced_is_told_before_the_work(tmp_path, monkeypatch):
    def work(path: Path) -> None:
        raise AssertionError("the work was done")

    monkeypatch.chdir(tmp_path)
    for place in (Path("."), tmp_path):
        with pytest.raises(DatasetError, match="the folder one is in; name a new one"):
            write_folder(place, work)
    with pytest.raises(OutputError, match="Is a directory"), new_file(tmp_path) as unfinished:
        work(unfinished)


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
