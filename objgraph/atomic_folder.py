"""A folder that appears complete or not at all."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from objgraph.errors import DatasetError


def write_folder(root: Path, write: Callable[[Path], None]) -> Path:
    """Let `write` fill a new folder and give it the name `root`, which must not exist or be empty.

    Raises:
        DatasetError: `root` is in use, or cannot be written.
    """
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise DatasetError(f"{root}: already there; remove it or name another folder")
    root.parent.mkdir(parents=True, exist_ok=True)
    building = Path(tempfile.mkdtemp(prefix=f".{root.name}-", dir=root.parent))
    try:
        write(building)
        building.chmod(0o755)
        os.replace(building, root)
    except OSError as error:
        raise DatasetError(f"{root}: the folder cannot be written ({error})") from error
    finally:
        shutil.rmtree(building, ignore_errors=True)
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
