"""Checks of depth and camera: unit, range, field of view."""

import numpy as np

from objgraph.doctor.section import Finding, Section
from objgraph.doctor.seen import Seen, SeenFrame

MEDIAN_M = (0.1, 20.0)
"""Median depth of a scan of objects, metres: a hand away to the width of a hall; another unit is a factor of ten off."""
LEVELS = 20
"""Different depths in the richest frame: metres cast to integers have a handful, even a bare wall has more."""
FIELD_OF_VIEW_DEG = (20.0, 150.0)
"""Of the wider edge: from a tele lens to more than a camera without distortion can have."""
SQUARE = 0.1
"""Share by which the focal lengths may differ: pixels of real sensors are square to a few per cent."""


def examine_depth(seen: Seen) -> Section:
    """The unit of depth, from its size and from how finely it is resolved."""
    low, median, high = seen.depths
    levels = max(frame.levels for frame in seen.frames)
    rows = (
        ("depth", f"median {median:.2f} m, 5 to 95 %: {low:.2f} to {high:.2f} m"),
        (
            "pixels with depth",
            f"{np.median([frame.measured for frame in seen.frames]):.0%} in the median frame",
        ),
    )
    findings = []
    if levels == 0:
        findings.append(Finding("depth", "no frame has any", "write depth as 16-bit images; 0 is for none"))
    elif levels < LEVELS:
        what = f"there are {levels} different depths in the frame that has most: metres cast to integers?"
        do = "write round(1000 * metres) as 16-bit images, depth_scale 1000"
        findings.append(Finding("depth", what, do))
    elif not MEDIAN_M[0] <= median <= MEDIAN_M[1]:
        what = f"the median depth is {median:.3g} m: the unit is not what it is taken for"
        do = "set depth_scale in intrinsics.json to the depth units in a metre (1000 where they are millimetres)"
        findings.append(Finding("depth", what, do))
    return Section("Depth", rows, tuple(findings))


def examine_camera(seen: Seen) -> Section:
    """The intrinsics against the images that they are for."""
    by_camera: dict[str, list[SeenFrame]] = {}
    for frame in seen.frames:
        by_camera.setdefault(repr(frame.intrinsics), []).append(frame)
    rows, findings = [], []
    for frames in by_camera.values():
        K = frames[0].intrinsics
        width, height = (2 * np.degrees(np.arctan(n / 2 / f)) for n, f in ((K.width, K.fx), (K.height, K.fy)))
        off = (K.cx - (K.width - 1) / 2) / K.width, (K.cy - (K.height - 1) / 2) / K.height
        rows += [
            ("images", f"{len(frames)} of {K.width}x{K.height} pixels"),
            ("intrinsics", f"fx {K.fx:.1f}, fy {K.fy:.1f}, cx {K.cx:.1f}, cy {K.cy:.1f}"),
            ("field of view", f"{width:.0f} x {height:.0f} degrees"),
            ("principal point", f"{off[0]:+.1%} of the width, {off[1]:+.1%} of the height from the middle"),
        ]
        do = "use the intrinsics of the camera that took these images, with the width and height that they are for"
        if not FIELD_OF_VIEW_DEG[0] <= max(width, height) <= FIELD_OF_VIEW_DEG[1]:
            what = f"a field of view of {max(width, height):.0f} degrees is no usual camera's"
            findings.append(Finding("intrinsics", what, do))
        if abs(np.log(K.fx / K.fy)) > np.log1p(SQUARE):
            what = f"fx {K.fx:.1f} and fy {K.fy:.1f} differ: the matrix is for images of other proportions"
            findings.append(Finding("intrinsics", what, do))
    return Section("Camera", tuple(rows), tuple(findings))
