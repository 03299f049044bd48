"""Files and folders that appear whole or not at all.

They are made under a name of their own beside their place. What a kill leaves of them goes with the next write into the same
folder: whoever makes one holds a lock on it, which ends with the process. A link stays, and what it leads to is written. What
replaces something has its mode, and what is new the mode that the process gives.
"""

import errno
import fcntl
import os
import secrets
import shutil
import stat
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
        place = _led_to(path)
        if place.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        place.parent.mkdir(parents=True, exist_ok=True)
        with _unfinished(place, _empty_file) as (unfinished, handle, mode):
            yield unfinished
            os.fsync(handle)
            unfinished.chmod(mode)
            os.replace(unfinished, place)
    except OSError as problem:
        raise error(f"{path}: cannot be written ({problem})") from problem


def check_place(path: Path, error: type[ObjectGraphError] = OutputError) -> None:
    """Whether `write_file` could write here, asked before long work; nothing is left of the question.

    Raises:
        error: it could not, whatever is in the way.
    """
    try:
        place = _led_to(path)
        if place.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        folder = next(above for above in place.parents if above.exists())
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
        place = _led_to(root)
        if place.exists():
            if not place.is_dir() or any(place.iterdir()):
                raise DatasetError(f"{root}: already there; remove it or name another folder")
            if place.is_mount() or place.samefile("."):  # neither can be replaced
                raise DatasetError(
                    f"{root}: where a disk is mounted, or the folder one is in; name a new one inside it"
                )
        place.parent.mkdir(parents=True, exist_ok=True)
        with _unfinished(place, _empty_folder) as (unfinished, _, mode):
            write(unfinished)
            unfinished.chmod(mode)
            os.replace(unfinished, place)
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


def _led_to(path: Path) -> Path:
    """What a path leads to when all links in it are followed, be it there or not."""
    return Path(os.path.realpath(path))


@contextmanager
def _unfinished(place: Path, make: Callable[[Path], int]) -> Iterator[tuple[Path, int, int]]:
    """Something new beside `place`, locked while it is open, and the mode that is due; it is gone afterwards, unless it was
    renamed. `make` makes it at a name and opens it."""
    _sweep(place.parent)
    while True:
        unfinished = place.with_name(_unfinished_name(place.name))
        handle = make(unfinished)
        with suppress(OSError):  # not every file system has locks: nothing is swept there
            fcntl.flock(handle, fcntl.LOCK_EX)
        if unfinished.exists():
            break
        os.close(handle)  # swept before it was locked
    try:
        mode = stat.S_IMODE((place if place.exists() else unfinished).stat().st_mode)
        unfinished.chmod(0o700 if unfinished.is_dir() else 0o600)  # nobody's but one's own till it is done
        yield unfinished, handle, mode
    finally:
        _remove(unfinished)
        os.close(handle)


def _unfinished_name(name: str) -> str:
    """One of its own, no longer than a name may be."""
    begin = os.fsencode(name)[:80].decode(errors="ignore")
    return f".{begin}.{secrets.token_hex(8)}{UNFINISHED}"


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


def _empty_file(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask, as for any file


def _empty_folder(path: Path) -> int:
    path.mkdir()
    return os.open(path, os.O_RDONLY)
