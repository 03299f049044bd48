"""A posed RGB-D scan: what was understood of it, and what is wrong."""

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from objgraph.datasets.folder_files import UNUSED_MASKS
from objgraph.datasets.registry import load_scan
from objgraph.doctor.images import examine_camera, examine_depth
from objgraph.doctor.objects import examine_objects
from objgraph.doctor.poses import examine_poses
from objgraph.doctor.section import Finding, Section, listed
from objgraph.doctor.seen import Seen, look
from objgraph.doctor.up import examine_up
from objgraph.errors import ObjectGraphError
from objgraph.observation.frames import Scan

_NAMED = ("bag", "folder", "nerfstudio", "tum")
"""Data sets whose masks hold what the user named, and nothing else."""


@dataclass(frozen=True)
class Examined:
    """A scan's examination, and what a picture of it needs."""

    sections: tuple[Section, ...]
    scan: Scan | None = None
    """With the frames that can be read alone; None where there are none."""
    floor: float | None = None
    """Height along the scan's up, metres; None where none is known."""
    best: int = 0
    """The frame with most objects."""


def examine_scan(
    dataset: str,
    root: Path,
    scene: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Examined:
    """Read a whole scan by the data set's own loader, `options` are its; its typed errors and warnings are findings."""
    with _warnings() as warned:
        try:
            scan = load_scan(dataset, root, scene, **options)
            seen = look(scan, progress)
        except ObjectGraphError as error:
            return Examined((Section("Frames", findings=(*_told(warned), Finding.of(error, str(root)))),))
    files = [*_told(warned), *seen.findings, *_without_depth(seen)]
    rows = (("scan", scan.name), ("frames", f"{len(seen.frames)} of {len(scan.frames)} can be read"))
    first = Section("Frames", rows, tuple(files))
    if not seen.frames:
        return Examined((first,))
    geometry, floor = _geometry(seen)
    placed = not any(section.wrong for section in geometry)
    sections = (first, *geometry, examine_objects(seen, dataset in _NAMED, placed))
    return Examined(sections, seen.scan, floor, _fullest(seen))


def _geometry(seen: Seen) -> tuple[list[Section], float | None]:
    """Camera and depth, then the poses, then up with the floor's height: wrong ones make all that follows look wrong."""
    sections = [examine_camera(seen), examine_depth(seen)]
    if not any(section.wrong for section in sections):
        sections.append(examine_poses(seen))
    if not any(section.wrong for section in sections):
        up, floor = examine_up(seen)
        return [*sections, up], floor
    return [*sections, Section("The rest", (("not looked at", "until what is wrong is mended"),))], None


def _fullest(seen: Seen) -> int:
    """The frame with most objects; of several that with most of their pixels."""
    named = {instance.id for instance in seen.scan.instances}
    shown = [[n for i, n in frame.pixels.items() if i in named] for frame in seen.frames]
    return max(range(len(shown)), key=lambda i: (len(shown[i]), sum(shown[i])))


@contextmanager
def _warnings() -> Iterator[list[logging.LogRecord]]:
    """The loaders' warnings, kept in place of being printed, be they wanted elsewhere or not."""
    records: list[logging.LogRecord] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = records.append
    loaders = logging.getLogger("objgraph.datasets")
    propagated, loaders.propagate = loaders.propagate, False
    level = loaders.level
    loaders.setLevel(logging.WARNING)
    loaders.addHandler(handler)
    try:
        yield records
    finally:
        loaders.removeHandler(handler)
        loaders.setLevel(level)
        loaders.propagate = propagated


def _told(warned: list[logging.LogRecord]) -> list[Finding]:
    """What loaders warn of, above all of frames that they leave out; one finding for each kind of warning."""
    counts = Counter(record.msg for record in warned)
    findings = []
    for message, count in counts.items():
        first = next(record for record in warned if record.msg == message).getMessage()
        more = f" (and {count - 1} more such frames)" if count > 1 else ""
        left_out, unused = "left out" in message and "frame" in message, message == UNUSED_MASKS
        do = (
            "nothing, where these frames are not meant to be used; else write what is missing"
            if left_out
            else ""
        )
        if unused:
            do = "name each mask as its depth image"
        findings.append(Finding("masks" if unused else "frames", first + more, do, note=not unused))
    return findings


def _without_depth(seen: Seen) -> list[Finding]:
    empty = [frame.name for frame in seen.frames if frame.measured == 0]
    if len(empty) in (0, len(seen.frames)):
        return []
    what = f"{len(empty)} of {len(seen.frames)} frames have no depth: {listed(empty)}"
    return [Finding("frames", what, "write their depth, or remove these frames")]
