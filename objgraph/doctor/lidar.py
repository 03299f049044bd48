"""Scans of a LiDAR with detections: what was understood of them, and what is wrong."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from objgraph.datasets.registry import lidar_frames, load_lidar_frame
from objgraph.doctor.section import Finding, Section, listed
from objgraph.errors import ObjectGraphError
from objgraph.observation.lidar.frame import LidarFrame

FILLED = 5
"""Returns that a detected box must hold to be a box about something."""
EMPTY = 0.5
"""Share of boxes that may hold less: detectors see far cars by few returns, but a wrong calibration empties them all."""


def examine_lidar(
    dataset: str,
    root: Path,
    frame: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Section, ...]:
    """Read one frame of a data set, or all; a typed error is a finding."""
    read: list[LidarFrame] = []
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
            read.append(load_lidar_frame(dataset, root, name))
        except ObjectGraphError as error:
            findings.append(Finding.of(error, f"frame {name}"))
        if progress is not None:
            progress(i + 1, len(names))
    rows = [("frames", f"{len(read)} of {len(names)} can be read")]
    if read:
        rows += _scans(read)
    sections = (Section("Frames", tuple(rows), tuple(findings)),)
    return (*sections, _detections(read)) if read else sections


def _scans(read: list[LidarFrame]) -> list[tuple[str, str]]:
    counts = [len(each.p_lidar) for each in read]
    reach = np.median([np.percentile(np.linalg.norm(each.p_lidar, axis=1), 95) for each in read])
    pictures = [each.picture for each in read if each.picture is not None]
    rows = [
        ("returns", f"{np.median(counts):.0f} in the median scan, 95 % within {reach:.0f} m"),
        ("pictures", f"{len(pictures)} of {len(read)} frames"),
        ("masks", f"{sum(each.instances is not None for each in pictures)} of {len(read)} frames"),
    ]
    if pictures:
        K = pictures[0].intrinsics
        view = 2 * np.degrees(np.arctan(K.width / 2 / K.fx))
        rows.append(("camera", f"{K.width}x{K.height} pixels, fx {K.fx:.1f}, {view:.0f} degrees wide"))
    return rows


def _detections(read: list[LidarFrame]) -> Section:
    held = {
        f"frame {frame.name}, {each.name}": int(np.count_nonzero(each.outside(frame.p_world) <= 0))
        for frame in read
        for each in frame.detections
    }
    if not held:
        what = "nothing is detected that could be mapped"
        do = "put a detector's boxes beside the scans, of KITTI into detections/NNNNNN.txt; cars are mapped"
        return Section("Detections", findings=(Finding("detections", what, do),))
    categories = Counter(each.category for frame in read for each in frame.detections)
    without = sum(not frame.detections for frame in read)
    rows = [(category, f"{count} detected") for category, count in categories.items()]
    rows.append(("returns in a box", f"{np.median(list(held.values())):.0f} in the median one"))
    rows.append(("frames without any", str(without)))
    empty = [name for name, count in held.items() if count < FILLED]
    if len(empty) <= EMPTY * len(held):
        return Section("Detections", tuple(rows))
    what = f"{len(empty)} of {len(held)} boxes hold less than {FILLED} returns of the LiDAR: {listed(empty)}"
    do = "see that boxes and calibration belong to these scans, and in which frame boxes are (docs/guides/lidar.md)"
    return Section("Detections", tuple(rows), (Finding("detections", what, do),))
