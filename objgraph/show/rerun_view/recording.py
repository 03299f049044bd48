"""A recording: where it begins, and how it comes to a file or a screen."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr

from objgraph.atomic import check_place, write_file
from objgraph.errors import ViewError

ENDING = ".rrd"


def new_recording(name: str) -> rr.RecordingStream:
    """An empty recording, which is kept in memory until it is saved or shown."""
    recording = rr.RecordingStream("objgraph")
    recording.send_recording_name(name)
    # what was logged when is of no interest
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    return recording


def check_recording(path: Path) -> None:
    """Whether a recording could be written here, asked before long work.

    Raises:
        ViewError: the name does not end in .rrd, or the file cannot be written.
    """
    if path.suffix != ENDING:
        raise ViewError(f"{path}: the viewer knows recordings by their ending; name it {path.name}{ENDING}")
    check_place(path, ViewError)


def save_recording(recording: rr.RecordingStream, path: Path | str) -> Path:
    """Write the recording at once: the file is there whole or not at all. The recording takes nothing more afterwards.

    Raises:
        ViewError: the name does not end in .rrd, or the file cannot be written.
    """
    path = Path(path)
    check_recording(path)
    # its own writing to a file never ends where the disk is full
    write_file(path, recording.memory_recording().drain_as_bytes(), ViewError)
    recording.disconnect()
    return path


def show_recording(recording: rr.RecordingStream) -> None:
    """Start the viewer, or use one that runs already, and send it the recording.

    Raises:
        ViewError: no viewer can be started.
    """
    try:
        with _beside_python_first():
            recording.spawn()
        recording.flush()
    except (OSError, RuntimeError, ValueError) as error:
        problem = str(error).strip().partition("\n")[0]
        raise ViewError(
            f"the viewer does not start ({problem}); --save FILE{ENDING} writes a file for it"
        ) from error


@contextmanager
def _beside_python_first() -> Iterator[None]:
    """The viewer's program is looked for on PATH, where that of an environment is only once it is activated."""
    before = os.environ.get("PATH")
    os.environ["PATH"] = os.pathsep.join(filter(None, (str(Path(sys.executable).parent), before)))
    try:
        yield
    finally:
        if before is None:
            del os.environ["PATH"]
        else:
            os.environ["PATH"] = before


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
