"""Scans of a LiDAR with detections: what was understood of them, and what is wrong."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from objgraph.datasets.registry import lidar_frames, load_lidar_frame
from objgraph.doctor.section import Finding, Section, listed
from objgraph.errors import ObjectGraphError
from objgraph.observation.frames import Intrinsics
from objgraph.observation.lidar.frame import LidarFrame

FILLED = 5
"""Returns that a detected box must hold to be a box about something."""
EMPTY = 0.5
"""Share of boxes that may hold less: detectors see far cars by few returns, but a wrong calibration empties them all."""


@dataclass(frozen=True)
class _Seen:
    """What is kept of a scan: a data set may have thousands."""

    returns: int
    reach: float
    """Distance within which 95 % of them are, metres."""
    camera: Intrinsics | None
    """Of the picture; None without one."""
    masked: bool
    categories: tuple[str, ...]
    """Of its detections."""
    held: dict[str, int]
    """Returns in each detected box, by frame and object."""

    @classmethod
    def of(cls, frame: LidarFrame) -> "_Seen":
        picture = frame.picture
        return cls(
            len(frame.p_lidar),
            float(np.percentile(np.linalg.norm(frame.p_lidar, axis=1), 95)),
            None if picture is None else picture.intrinsics,
            picture is not None and picture.instances is not None,
            tuple(each.category for each in frame.detections),
            {
                f"frame {frame.name}, {each.name}": int(np.count_nonzero(each.outside(frame.p_world) <= 0))
                for each in frame.detections
            },
        )


def examine_lidar(
    dataset: str,
    root: Path,
    frame: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Section, ...]:
    """Read one frame of a data set, or all; a typed error is a finding."""
    read: list[_Seen] = []
    findings = []
    try:
        names = [frame] if frame is not None else lidar_frames(dataset, root)
    except ObjectGraphError as error:
        return (Section("Frames", findings=(Finding.of(error, str(root)),)),)
    if not names:
        findings.append(
            Finding(str(root), "there is no scan of a LiDAR", "put the scans there (docs/guides)")
        )
    for i, name in enumerate(names):
        try:
            read.append(_Seen.of(load_lidar_frame(dataset, root, name)))
        except ObjectGraphError as error:
            findings.append(Finding.of(error, f"frame {name}"))
        if progress is not None:
            progress(i + 1, len(names))
    rows = [("frames", f"{len(read)} of {len(names)} can be read")]
    if read:
        rows += _scans(read)
    sections = (Section("Frames", tuple(rows), tuple(findings)),)
    return (*sections, _detections(read)) if read else sections


def _scans(read: list[_Seen]) -> list[tuple[str, str]]:
    counts, reaches = [each.returns for each in read], [each.reach for each in read]
    cameras = [each.camera for each in read if each.camera is not None]
    rows = [
        ("returns", f"{np.median(counts):.0f} in the median scan, 95 % within {np.median(reaches):.0f} m"),
        ("pictures", f"{len(cameras)} of {len(read)} frames"),
        ("masks", f"{sum(each.masked for each in read)} of {len(read)} frames"),
    ]
    if cameras:
        K = cameras[0]
        view = 2 * np.degrees(np.arctan(K.width / 2 / K.fx))
        rows.append(("camera", f"{K.width}x{K.height} pixels, fx {K.fx:.1f}, {view:.0f} degrees wide"))
    return rows


def _detections(read: list[_Seen]) -> Section:
    held = {name: count for each in read for name, count in each.held.items()}
    if not held:
        what = "nothing is detected that could be mapped"
        do = "put a detector's boxes beside the scans, of KITTI into detections/NNNNNN.txt; cars are mapped"
        return Section("Detections", findings=(Finding("detections", what, do),))
    categories = Counter(category for each in read for category in each.categories)
    without = sum(not each.held for each in read)
    rows = [(category, f"{count} detected") for category, count in categories.items()]
    rows.append(("returns in a box", f"{np.median(list(held.values())):.0f} in the median one"))
    rows.append(("frames without any", str(without)))
    empty = [name for name, count in held.items() if count < FILLED]
    if len(empty) <= EMPTY * len(held):
        return Section("Detections", tuple(rows))
    what = f"{len(empty)} of {len(held)} boxes hold less than {FILLED} returns of the LiDAR: {listed(empty)}"
    do = "see that boxes and calibration belong to these scans, and in which frame boxes are (docs/guides/lidar.md)"
    return Section("Detections", tuple(rows), (Finding("detections", what, do),))
