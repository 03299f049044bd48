"""Files and folders that appear whole or not at all.

They are made under a name of their own beside their place. What a kill leaves of them goes with the next write into the same
folder: whoever makes one holds a lock on it, which ends with the process.
"""

import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from objgraph.errors import DatasetError, ObjectGraphError, OutputError

UNFINISHED = ".objgraph-unfinished"
"""How names of what is being made end."""


def write_file(path: Path, data: bytes, error: type[ObjectGraphError] = OutputError) -> None:
    """Write a file, and the folders above it, in place of an earlier one.

    Raises:
        error: it cannot be written; what was there before is still there.
    """
    with new_file(path, error) as unfinished:
        unfinished.write_bytes(data)


@contextmanager
def new_file(path: Path, error: type[ObjectGraphError] = OutputError) -> Iterator[Path]:
    """The same for what writes files itself: it is given a name to write to, which becomes `path` after the block."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _unfinished(path, _empty_file) as (unfinished, handle):
            yield unfinished
            os.fsync(handle)
            unfinished.chmod(0o644)
            os.replace(unfinished, path)
    except OSError as problem:
        raise error(f"{path}: cannot be written ({problem})") from problem


def check_place(path: Path, error: type[ObjectGraphError] = OutputError) -> None:
    """Whether `write_file` could write here, asked before long work; nothing is left of the question.

    Raises:
        error: it could not, whatever is in the way.
    """
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        folder = next(above for above in path.absolute().parents if above.exists())
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        raise error(f"{path}: cannot be written ({problem})") from problem


def write_folder(root: Path, write: Callable[[Path], None]) -> Path:
    """Let `write` fill a new folder and give it the name `root`, which must not exist or be empty.

    Raises:
        DatasetError: `root` is in use, or cannot be written.
    """
    try:
        if root.exists() and (not root.is_dir() or any(root.iterdir())):
            raise DatasetError(f"{root}: already there; remove it or name another folder")
        root.parent.mkdir(parents=True, exist_ok=True)
        with _unfinished(root, _empty_folder) as (unfinished, _):
            write(unfinished)
            unfinished.chmod(0o755)
            os.replace(unfinished, root)
    except OSError as error:
        raise DatasetError(f"{root}: the folder cannot be written ({error})") from error
    return root


def ensure_folder(root: Path, record: str, write: Callable[[Path], None]) -> Path:
    """The same unless `root` holds the file `record` already, be it by another process."""
    if (root / record).is_file():
        return root
    try:
        return write_folder(root, write)
    except DatasetError:
        if (root / record).is_file():
            return root
        raise


@contextmanager
def _unfinished(path: Path, make: Callable[[Path], tuple[Path, int]]) -> Iterator[tuple[Path, int]]:
    """Something new beside `path`, locked while it is open; it is gone afterwards, unless it was renamed."""
    _sweep(path.parent)
    while True:
        unfinished, handle = make(path)
        with suppress(OSError):  # not every file system has locks: nothing is swept there
            fcntl.flock(handle, fcntl.LOCK_EX)
        if unfinished.exists():
            break
        os.close(handle)  # swept before it was locked
    try:
        yield unfinished, handle
    finally:
        _remove(unfinished)
        os.close(handle)


def _sweep(folder: Path) -> None:
    """Remove what processes that have ended left here."""
    for name in os.listdir(folder):
        if name.endswith(UNFINISHED):
            with suppress(OSError):  # in use, another's, or gone meanwhile
                handle = os.open(folder / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(folder / name)
                finally:
                    os.close(handle)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _empty_file(path: Path) -> tuple[Path, int]:
    handle, name = tempfile.mkstemp(UNFINISHED, f".{path.name}.", path.parent)
    return Path(name), handle


def _empty_folder(path: Path) -> tuple[Path, int]:
    name = tempfile.mkdtemp(UNFINISHED, f".{path.name}.", path.parent)
    return Path(name), os.open(name, os.O_RDONLY)
