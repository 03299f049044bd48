"""Trajectories as text in the TUM format, which SLAM systems write and evo reads, and their absolute error."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from objgraph.atomic import write_file
from objgraph.errors import DatasetError, EvaluationError

log = logging.getLogger(__name__)

MAX_DIFFERENCE = 0.02
"""Seconds by which two timestamps of one moment may differ; that of the TUM benchmark's own tools."""

_TOLERANCE = 1e-2
_SAME_MOMENT = 1e-4
_FORM = "timestamp tx ty tz qx qy qz qw"


@dataclass(frozen=True)
class Trajectory:
    """A camera's poses over time. Raises `DatasetError` for what is no trajectory."""

    timestamps: Float[np.ndarray, "n"]
    """Seconds; each later than the one before."""
    T_world_camera: Float[np.ndarray, "n 4 4"]
    """Camera to world, one a timestamp."""

    def __post_init__(self) -> None:
        timestamps = np.asarray(self.timestamps, dtype=float).reshape(-1)
        poses = np.asarray(self.T_world_camera, dtype=float).reshape(-1, 4, 4)
        if len(timestamps) != len(poses):
            raise DatasetError(f"a trajectory of {len(timestamps)} timestamps and {len(poses)} poses")
        if not np.isfinite(timestamps).all() or (np.diff(timestamps) <= 0).any():
            raise DatasetError("a trajectory's timestamps must be numbers, each later than the one before")
        finite = np.isfinite(poses).all(axis=(1, 2), keepdims=True)
        rotations = np.where(finite, poses[:, :3, :3], 0)
        error = np.abs(rotations.swapaxes(1, 2) @ rotations - np.eye(3)).max(axis=(1, 2), initial=0)
        rigid = (error < _TOLERANCE) & (np.linalg.det(rotations) > 0)
        rigid &= np.abs(poses[:, 3] - [0, 0, 0, 1]).max(axis=1, initial=0) < _TOLERANCE
        if not rigid.all():
            bad = int(np.argmin(rigid))
            raise DatasetError(f"the trajectory's pose {bad} is no rigid transform: leave such poses out")
        object.__setattr__(self, "timestamps", timestamps)
        object.__setattr__(self, "T_world_camera", poses)

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def positions(self) -> Float[np.ndarray, "n 3"]:
        """The camera's centre in the world frame, metres."""
        return self.T_world_camera[:, :3, 3]


def read_labelled_poses(path: Path) -> dict[str, Float[np.ndarray, "4 4"]]:
    """T_world_camera by the first word of each line; the other seven are those of the TUM format.

    Of several lines with the same first word the first is kept and the others are logged. Empty lines and those
    that begin with `#` are comments; commas may separate. Raises `DatasetError`, with the line, for what is missing,
    no number, not finite, or no unit quaternion.
    """
    poses: dict[str, np.ndarray] = {}
    repeated = []
    for number, words in numbered_words(path):
        if words[0] in poses:
            repeated.append(words[0])
        else:
            poses[words[0]] = _pose(words[1:], f"{path}, line {number}")
    if not poses:
        raise DatasetError(f"{path}: holds no pose; every line must be '{_FORM}'")
    if repeated:
        log.warning("%s: %s begins several lines; the first of them counts", path, ", ".join(repeated[:5]))
    return poses


def numbered_words(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The words of each line that is not empty and no comment (`#`), with the line's number; commas separate too.

    Raises `DatasetError` where the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); is it the right folder?") from error
    for number, line in enumerate(text.splitlines(), 1):
        words = line.replace(",", " ").split()
        if words and not words[0].startswith("#"):
            yield number, words


def read_tum(path: Path) -> Trajectory:
    """A trajectory in the TUM format: lines `timestamp tx ty tz qx qy qz qw`, in any order.

    Raises `DatasetError`; see `read_labelled_poses`.
    """
    poses = read_labelled_poses(path)
    try:
        timestamps = np.array([float(label) for label in poses])
    except ValueError as error:
        raise DatasetError(f"{path}: a line begins with no timestamp ({error}); write '{_FORM}'") from error
    unique, order = np.unique(timestamps, return_index=True)  # '1.5' and '1.50' are two labels
    try:
        return Trajectory(unique, np.array(list(poses.values()))[order])
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from error


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write the TUM format, atomically, with every digit that a float has; what is read back is what was written.

    Raises `DatasetError` where the file cannot be written.
    """
    quaternions = Rotation.from_matrix(trajectory.T_world_camera[:, :3, :3]).as_quat(canonical=True)
    rows = np.column_stack([trajectory.timestamps, trajectory.positions, quaternions]).tolist()
    lines = [f"# {_FORM}", *(" ".join(map(repr, row)) for row in rows)]
    write_file(path, ("\n".join(lines) + "\n").encode(), DatasetError)


def associate(
    first: Float[np.ndarray, "n"], second: Float[np.ndarray, "m"], max_difference: float = MAX_DIFFERENCE
) -> Int[np.ndarray, "k 2"]:
    """Index pairs of timestamps that are at most `max_difference` seconds apart, in the order of `first`.

    Each timestamp is in one pair at most; the closest pairs are made first.
    """
    order = np.argsort(second, kind="stable")
    low = np.searchsorted(second[order], first - max_difference, side="left")
    high = np.searchsorted(second[order], first + max_difference, side="right")
    pairs = np.array(
        [(i, order[k]) for i in range(len(first)) for k in range(low[i], high[i])], dtype=int
    ).reshape(-1, 2)
    closest = np.argsort(np.abs(first[pairs[:, 0]] - second[pairs[:, 1]]), kind="stable")
    taken: tuple[set[int], set[int]] = (set(), set())
    kept = []
    for i, k in pairs[closest].tolist():
        if i not in taken[0] and k not in taken[1]:
            taken[0].add(i)
            taken[1].add(k)
            kept.append((i, k))
    return np.array(sorted(kept), dtype=int).reshape(-1, 2)


def interpolate(
    trajectory: Trajectory, times: Float[np.ndarray, "n"], max_difference: float
) -> Float[np.ndarray, "n 4 4"]:
    """T_world_camera at other moments: between the poses before and after, linear in position, slerp in rotation.

    Both must be at most `max_difference` seconds away, or one at the same moment (0.1 ms, to which text is rounded);
    elsewhere the pose is NaN.
    """
    stamps, poses = trajectory.timestamps, trajectory.T_world_camera
    last = len(stamps) - 1
    after = np.clip(np.searchsorted(stamps, times), 0, last)
    before = np.maximum(np.where(stamps[after] <= times, after, after - 1), 0)
    nearest = np.where(np.abs(stamps[after] - times) < np.abs(stamps[before] - times), after, before)
    same = np.abs(stamps[nearest] - times) <= _SAME_MOMENT
    before, after = np.where(same, nearest, before), np.where(same, nearest, after)
    gap = stamps[after] - stamps[before]
    share = np.where(gap > 0, times - stamps[before], 0) / np.where(gap > 0, gap, 1)
    first = Rotation.from_matrix(poses[before, :3, :3])
    turn = first.inv() * Rotation.from_matrix(poses[after, :3, :3])
    found = np.tile(np.eye(4), (len(times), 1, 1))
    found[:, :3, :3] = (first * Rotation.from_rotvec(share[:, None] * turn.as_rotvec())).as_matrix()
    found[:, :3, 3] = poses[before, :3, 3] + share[:, None] * (poses[after, :3, 3] - poses[before, :3, 3])
    around = (stamps[before] <= times) & (times <= stamps[after])
    near = np.maximum(np.abs(times - stamps[before]), np.abs(stamps[after] - times)) <= max_difference
    found[~(same | (around & near))] = np.nan
    return found


def absolute_trajectory_error(
    estimate: Trajectory,
    truth: Trajectory,
    align: Literal["none", "rigid"] = "none",
    max_difference: float = MAX_DIFFERENCE,
) -> float:
    """Root mean square distance in metres between the positions of two trajectories at the same moments.

    `align="rigid"` first moves the estimate onto the truth by the rotation and translation that make this error
    least (Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991,
    without the scale). Poses without a partner within `max_difference` seconds do not count.
    Raises `EvaluationError` where no pose has a partner, or fewer than three where they are to be aligned.
    """
    if align not in ("none", "rigid"):
        raise EvaluationError(f"no alignment '{align}' of trajectories; there are none and rigid")
    pairs = associate(estimate.timestamps, truth.timestamps, max_difference)
    needed = 3 if align == "rigid" else 1
    if len(pairs) < needed:
        raise EvaluationError(
            f"{len(pairs)} poses of the trajectory ({len(estimate)}) and of the truth ({len(truth)}) are within "
            f"{max_difference} s of each other, {needed} are needed: are their clocks and units the same?"
        )
    p_estimate, p_truth = estimate.positions[pairs[:, 0]], truth.positions[pairs[:, 1]]
    if align == "rigid":
        p_estimate = _aligned(p_estimate, p_truth)
    return float(np.sqrt(np.mean(np.sum((p_estimate - p_truth) ** 2, axis=1))))


def _aligned(points: Float[np.ndarray, "n 3"], onto: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The points, moved rigidly to where the sum of squared distances is least."""
    centred = points - points.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - onto.mean(axis=0)).T @ centred)
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))  # a rotation, never a reflection
    return centred @ (u @ vt).T + onto.mean(axis=0)


def _pose(words: list[str], origin: str) -> Float[np.ndarray, "4 4"]:
    """The transform of `tx ty tz qx qy qz qw`."""
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise DatasetError(f"{origin}: {error}; write '{_FORM}'") from error
    if numbers.shape != (7,):
        raise DatasetError(f"{origin}: {len(words) + 1} words instead of the 8 of '{_FORM}'")
    if not np.isfinite(numbers).all():
        raise DatasetError(f"{origin}: the pose holds NaN or infinity; delete the line to leave it out")
    length = float(np.linalg.norm(numbers[3:]))
    if abs(length - 1) > _TOLERANCE:
        raise DatasetError(f"{origin}: the quaternion's length is {length:.3g} instead of 1; write '{_FORM}'")
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = Rotation.from_quat(numbers[3:]).as_matrix()
    T_world_camera[:3, 3] = numbers[:3]
    return T_world_camera
