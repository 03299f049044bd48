"""Checks of depth and camera: unit, range, field of view."""

from collections.abc import Sequence

import numpy as np

from objgraph.doctor.section import Finding, Section
from objgraph.doctor.seen import Seen
from objgraph.observation.frames import Intrinsics

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
    """The intrinsics against the images that they are for; frames may have cameras of their own."""
    by_size: dict[tuple[int, int], list[Intrinsics]] = {}
    for frame in seen.frames:
        K = frame.intrinsics
        by_size.setdefault((K.width, K.height), []).append(K)
    rows = [row for cameras in by_size.values() for row in _camera_rows(cameras)]
    cameras = [frame.intrinsics for frame in seen.frames]
    unusual = [
        max(fov)
        for fov in map(_field_of_view, cameras)
        if not FIELD_OF_VIEW_DEG[0] <= max(fov) <= FIELD_OF_VIEW_DEG[1]
    ]
    uneven = [K for K in cameras if abs(np.log(K.fx / K.fy)) > np.log1p(SQUARE)]
    do = (
        "use the intrinsics of the camera that took these images, with the width and height that they are for"
    )
    findings = []
    if unusual:
        what = f"a field of view of {_span(unusual, '.0f')} degrees is no usual camera's"
        findings.append(Finding("intrinsics", what + _of(len(unusual), cameras), do))
    if uneven:
        sides = f"fx {_span([K.fx for K in uneven], '.1f')} and fy {_span([K.fy for K in uneven], '.1f')}"
        what = f"{sides} differ: the matrix is for images of other proportions"
        findings.append(Finding("intrinsics", what + _of(len(uneven), cameras), do))
    return Section("Camera", tuple(rows), tuple(findings))


def _camera_rows(cameras: Sequence[Intrinsics]) -> list[tuple[str, str]]:
    """Of cameras whose images are of one size."""
    width, height = cameras[0].width, cameras[0].height
    K = {name: _span([getattr(each, name) for each in cameras], ".1f") for name in ("fx", "fy", "cx", "cy")}
    across, down = (_span(values, ".0f") for values in zip(*map(_field_of_view, cameras), strict=True))
    right = _span([(each.cx - (width - 1) / 2) / width for each in cameras], "+.1%")
    below = _span([(each.cy - (height - 1) / 2) / height for each in cameras], "+.1%")
    return [
        ("images", f"{len(cameras)} of {width}x{height} pixels"),
        ("intrinsics", ", ".join(f"{name} {value}" for name, value in K.items())),
        ("field of view", f"{across} x {down} degrees"),
        ("principal point", f"{right} of the width, {below} of the height from the middle"),
    ]


def _field_of_view(K: Intrinsics) -> tuple[float, float]:
    """Across and down, degrees."""
    across, down = (2 * np.degrees(np.arctan(n / 2 / f)) for n, f in ((K.width, K.fx), (K.height, K.fy)))
    return float(across), float(down)


def _span(values: Sequence[float], form: str) -> str:
    low, high = (format(value, form) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _of(count: int, cameras: Sequence[Intrinsics]) -> str:
    """How many frames, where it is not all."""
    return "" if count == len(cameras) else f" (in {count} of {len(cameras)} frames)"
