"""Check of the poses: what one frame measures must be where another frame measures it.

Points of a frame are moved into another by both poses. Where the other camera looks straight through them, they are
not there: with right poses that hardly happens, since what is hidden behind something nearer does not count. The same
is asked of poses that were written in another convention.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from objgraph.doctor.section import Finding, Section
from objgraph.doctor.seen import Seen
from objgraph.geometry.frames import transformed, transformed_back
from objgraph.observation.frames import Frame

AGREE = 0.85
"""Share of points found again below which poses and depth contradict each other: right poses reach 0.98 on a Kinect's
frames, those of the next frame 0.8 to 0.9, wrong ones find about half."""
BETTER = 0.1
"""Share by which another convention must find more to be the right one: slow cameras tell little, noise less."""
MOVES = 0.03
"""Share by which it must find more than the same cameras all in one place, too: whatever shrinks bad poses finds more where
the camera hardly moved."""
FAR = 100
"""Times the median depth that cameras may be apart: a walk through a large flat is 25, millimetres are a thousand."""
ENOUGH = 500
"""Points that two frames must share for a verdict."""
STILL_M, STILL_RAD = 1e-3, 1e-3
"""Motion of cameras below which they did not move: less than any tracker resolves."""
_TOLERANCE = 0.05
"""Metres, or this share of the depth where that is more: sensor noise, drift, a pixel's width at a slant."""
_ANCHORS, _GAPS = 12, (1, 4, 16)
"""Frames spread over the scan, each compared with some that come soon after it: slow and quick cameras both overlap."""
_STRIDE = 8
_NEAR, _MAX_DEPTH = 0.1, 8.0
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def _with_rotation(
    T: Float[np.ndarray, "4 4"], quaternion: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "4 4"]:
    return np.block([[Rotation.from_quat(quaternion).as_matrix(), T[:3, 3:]], [T[3:]]])


def _scaled(T: Float[np.ndarray, "4 4"], factor: float) -> Float[np.ndarray, "4 4"]:
    return np.block([[T[:3, :3], factor * T[:3, 3:]], [T[3:]]])


@dataclass(frozen=True)
class _Convention:
    """How poses may have been written."""

    what: str
    to_camera_to_world: Callable[[Float[np.ndarray, "4 4"]], Float[np.ndarray, "4 4"]]
    """Their T_world_camera."""
    do: str = ""


_GIVEN = _Convention("as they are", lambda T: T)
_STILL = _Convention("all in one place", lambda T: _scaled(T, 0.0))
_OTHERS = (
    _Convention(
        "inverted (world-to-camera in place of camera-to-world)",
        np.linalg.inv,
        "write T_world_camera: np.linalg.inv of each matrix that is there",
    ),
    _Convention(
        "of a camera that looks along its -z axis (OpenGL)",
        lambda T: T @ _OPENGL,
        "write them for a camera with x right, y down, z forward (in nerfstudio's transforms.json: x right, y up, z back): "
        "multiply from the right with diag(1, -1, -1, 1)",
    ),
    _Convention(
        "view matrices (inverted, of a camera that looks along its -z axis: OpenGL)",
        lambda T: np.linalg.inv(T) @ _OPENGL,
        "write T_world_camera: np.linalg.inv of each matrix, times diag(1, -1, -1, 1) from the right",
    ),
    _Convention(
        "written as quaternions with w first and read as if it came last",
        lambda T: _with_rotation(T, np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), -1)),
        "write quaternions as x y z w",
    ),
    *(
        _Convention(
            f"written in another unit than depth, which is {factor:g} times what it should be",
            lambda T, factor=factor: _scaled(T, factor),
            f"divide depth by {factor:g} (`depth_scale` in intrinsics.json, or of the loader), or multiply the poses' translations",
        )
        for factor in (5.0, 0.2, 10.0, 0.1)
    ),
    _Convention("written in centimetres", lambda T: _scaled(T, 0.01), "write their translations in metres"),
)


@dataclass
class _Agreement:
    """What of a frame's points another camera sees where they should be, and what it sees through."""

    convention: _Convention
    _off: list[Float[np.ndarray, "n"]] = field(default_factory=list)
    """Differences in depth, metres."""
    _found: list[Bool[np.ndarray, "n"]] = field(default_factory=list)

    def compare(self, a: Frame, b: Frame) -> None:
        """Points of `a` where `b` has them in its picture."""
        T_world_a = self.convention.to_camera_to_world(a.T_world_camera)
        T_world_b = self.convention.to_camera_to_world(b.T_world_camera)
        p_b = transformed_back(T_world_b, transformed(T_world_a, _points(a)))
        p_b = p_b[p_b[:, 2] > _NEAR]
        u, v = np.round(b.intrinsics.project(p_b)).T
        inside = (u >= 0) & (u < b.intrinsics.width) & (v >= 0) & (v < b.intrinsics.height)
        seen = b.depth[v[inside].astype(int), u[inside].astype(int)]
        known = np.isfinite(seen) & (seen > 0)
        past = (seen - p_b[inside, 2])[known]
        tolerance = _TOLERANCE * np.maximum(1.0, seen[known])
        shown = past >= -tolerance  # the others are hidden behind something
        self._off.append(np.abs(past[shown]))
        self._found.append((past <= tolerance)[shown])

    @property
    def count(self) -> int:
        return sum(map(len, self._found))

    @property
    def share(self) -> float:
        """Of the points those that are found; 0 where there are too few to tell."""
        return float(np.concatenate(self._found).mean()) if self.count >= ENOUGH else 0.0

    @property
    def median(self) -> float:
        return float(np.median(np.concatenate(self._off)))


def examine_poses(seen: Seen) -> Section:
    """How far the cameras went, and whether depth agrees between frames."""
    poses = np.stack([frame.T_world_camera for frame in seen.frames])
    places = poses[:, :3, 3]
    length = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    span = np.ptp(places, axis=0)
    rows = [("path", f"{length:.2f} m long, within {' x '.join(f'{edge:.2f}' for edge in span)} m")]
    if len(poses) == 1:
        return Section("Poses", tuple(rows))
    if np.ptp(places, axis=0).max() < STILL_M and np.ptp(poses[:, :3, :3], axis=0).max() < STILL_RAD:
        what = f"all {len(poses)} poses are equal"
        do = "give each frame its own; of a camera that stands still one frame is enough"
        return Section("Poses", tuple(rows), (Finding("poses", what, do),))
    away, depth = float(np.linalg.norm(span)), seen.depths[1]
    if away > FAR * depth > 0:
        what = f"cameras are up to {away:.0f} m apart and look at what is {depth:.2g} m away"
        return Section("Poses", tuple(rows), (Finding("poses", what, "write their translations in metres"),))
    given, still, *others = _compared(seen)
    if given.count >= ENOUGH:
        found = f"{given.share:.0%} of what two frames should both see is there"
        rows.append(("agreement", f"{found}, the median {100 * given.median:.1f} cm off"))
    return Section("Poses", tuple(rows), tuple(_verdict(given, still, others)))


def _verdict(given: _Agreement, still: _Agreement, others: Sequence[_Agreement]) -> Iterator[Finding]:
    best = max(others, key=lambda other: other.share)
    if best.share >= max(AGREE, given.share + BETTER, still.share + MOVES):
        what = (
            f"the poses look {best.convention.what}: read so, {best.share:.0%} of what two frames should both see is "
            f"there, as they are {given.share:.0%}"
        )
        yield Finding("poses", what, best.convention.do)
    elif given.count < ENOUGH:
        what = "hardly any two frames see the same place, so poses cannot be checked against depth"
        yield Finding(
            "poses", what, "see that each pose is its own image's; more frames would tell", note=True
        )
    elif given.share < AGREE:
        what = (
            f"poses and depth disagree: of what two frames should both see {given.share:.0%} is there, the median "
            f"{100 * given.median:.0f} cm off"
        )
        do = (
            "see that each pose is its own image's, T_world_camera (x right, y down, z forward) in metres, and that "
            "depth's unit and the intrinsics are right"
        )
        yield Finding("poses", what, do)


def _compared(seen: Seen) -> list[_Agreement]:
    """The agreement of the poses as they are, all in one place, and read in each other way."""
    agreements = [_Agreement(convention) for convention in (_GIVEN, _STILL, *_OTHERS)]
    count = len(seen.frames)
    for i in np.unique(np.linspace(0, count - 1, min(_ANCHORS, count)).astype(int)):
        first = seen.scan.frames[int(i)]
        for other in (int(i) + gap for gap in _GAPS if i + gap < count):
            second = seen.scan.frames[other]
            for agreement in agreements:
                agreement.compare(first, second)
    return agreements


def _points(frame: Frame) -> Float[np.ndarray, "n 3"]:
    """Some of a frame's points, in its camera."""
    v, u = np.mgrid[: frame.depth.shape[0] : _STRIDE, : frame.depth.shape[1] : _STRIDE]
    depth = frame.depth[v, u]
    known = np.isfinite(depth) & (depth > 0)
    known &= depth < max(_MAX_DEPTH, 2 * float(np.median(depth[known])) if known.any() else 0.0)
    return frame.intrinsics.backproject(u[known], v[known]) * depth[known][:, None]
