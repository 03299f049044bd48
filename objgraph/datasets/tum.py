"""TUM RGB-D sequences (Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012), with masks.

Expected in `root`, or in `root/SCENE`: `depth.txt` and, for display, `rgb.txt` (lines `timestamp file`) with their
images, `groundtruth.txt`, and two things that the benchmark has not: `masks/NAME.png`, called as the depth or
the colour image of the frame, and `instances.json`; both are those of the plain folder (`folder.py`). Depth is
registered to the colour camera, whose calibration is known by the sequence's name; `intrinsics.json` or
`intrinsics.txt` is used in its place where it is there. The lens distortion of freiburg1 and freiburg2 is not
corrected.
"""

import logging
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objgraph.checked import inside
from objgraph.datasets.files import pick_folder, scan_folders
from objgraph.datasets.folder_files import (
    Camera,
    FrameFiles,
    build_scan,
    camera_file,
    mask_paths,
    read_camera,
)
from objgraph.datasets.trajectory import MAX_DIFFERENCE, Trajectory, associate, numbered_words, read_tum
from objgraph.errors import DatasetError
from objgraph.observation.frames import Scan

log = logging.getLogger(__name__)

CAMERAS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""fx, fy, cx, cy of the benchmark's three colour cameras, 640x480 pixels."""

_SIZE = (640, 480)
_UNITS_A_METRE = 5000.0


def scenes(root: Path) -> list[str]:
    """Names of the sequences: `root` itself, or the folders in it."""
    return list(scan_folders(root, "depth.txt"))


def load(
    root: Path,
    scene: str | None = None,
    *,
    stride: int = 1,
    trajectory: Path | None = None,
    intrinsics: Path | None = None,
    depth_scale: float | None = None,
    max_difference: float = MAX_DIFFERENCE,
) -> Scan:
    """The sequence in the folder `root`, or its subfolder `scene`; it has no ground truth of objects.

    A frame is a depth image with a mask and a pose, and perhaps a colour image, at most `max_difference` seconds
    away; others are left out with a warning. `stride` keeps every stride-th of them. `trajectory` is read in place of
    `groundtruth.txt` (T_world_camera, TUM format: what a SLAM system wrote), `intrinsics` in place of the scan's own
    or known camera. `depth_scale` (units a metre) is 5000 unless it or the intrinsics' file says otherwise.
    Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = pick_folder(root, "depth.txt", scene)
    camera = _camera(folder, intrinsics)
    depth = _read_list(folder / "depth.txt")
    _check_names(folder / "depth.txt", depth)
    images = _read_list(folder / "rgb.txt") if (folder / "rgb.txt").is_file() else {}
    colors = _colors(images, depth, max_difference)
    stems = {
        time: (path.stem, colors[time].stem) if time in colors else (path.stem,)
        for time, path in depth.items()
    }
    masks = mask_paths(
        folder,
        {depth[time].stem: names for time, names in stems.items()},
        [path.stem for path in images.values()],
    )
    path = trajectory or folder / "groundtruth.txt"
    if trajectory is None and not path.is_file():
        raise DatasetError(f"{folder}: no groundtruth.txt; give the option trajectory (--trajectory FILE)")
    times = np.array([time for time in depth if depth[time].stem in masks])
    poses = _poses(times, read_tum(path), path, max_difference)
    files = {
        depth[time].stem: FrameFiles(depth[time], masks[depth[time].stem], colors.get(time), pose)
        for time, pose in list(poses.items())[::stride]
    }
    return build_scan(folder, files, camera, depth_scale, _UNITS_A_METRE)


def _camera(folder: Path, given: Path | None) -> Camera:
    """The camera of the file given, of the file in the folder, or of the benchmark."""
    if given is not None:
        return read_camera(given)
    if any((folder / f"intrinsics.{suffix}").is_file() for suffix in ("json", "txt")):
        return read_camera(camera_file(folder))
    name = folder.resolve().name
    known = [numbers for key, numbers in CAMERAS.items() if key in name]
    if not known:
        raise DatasetError(
            f"{folder}: no intrinsics.json, and the folder's name tells no known camera ({', '.join(CAMERAS)}); "
            "write intrinsics.txt with 'fx fy cx cy'"
        )
    fx, fy, cx, cy = known[0]
    return Camera(f"{folder}: camera of {name}", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), _SIZE)


def _read_list(path: Path) -> dict[float, Path]:
    """The image of each timestamp, by rising time; of several with the same the first, and the others are logged."""
    images: dict[float, Path] = {}
    lost = 0
    for number, words in numbered_words(path):
        try:
            timestamp, name = words
            image = inside(path.parent, name)
            lost += images.setdefault(float(timestamp), image) is not image
        except ValueError as error:
            raise DatasetError(f"{path}, line {number}: must be 'timestamp file': {error}") from error
    if not images:
        raise DatasetError(f"{path}: names no image; every line must be 'timestamp file'")
    if lost:
        log.warning("%s: %d frames share another's time and are left out", path, lost)
    return dict(sorted(images.items()))


def _check_names(path: Path, depth: dict[float, Path]) -> None:
    """Raise `DatasetError` where two depth images have the same name: a frame is called by it."""
    times: dict[str, float] = {}
    for time, image in depth.items():
        if times.setdefault(image.stem, time) != time:
            raise DatasetError(
                f"{path}: the images at {times[image.stem]:.6f} and {time:.6f} s are both called {image.stem}; rename one"
            )


def _colors(colors: dict[float, Path], depth: dict[float, Path], max_difference: float) -> dict[float, Path]:
    """The colour image of each depth image that has one."""
    times, color_times = list(depth), list(colors)
    pairs = associate(np.array(times), np.array(color_times), max_difference)
    return {times[i]: colors[color_times[k]] for i, k in pairs}


def _poses(
    times: Float[np.ndarray, "n"], trajectory: Trajectory, path: Path, max_difference: float
) -> dict[float, Float[np.ndarray, "4 4"]]:
    """T_world_camera of each depth image that the trajectory has a pose for."""
    pairs = associate(times, trajectory.timestamps, max_difference)
    if len(pairs) == 0:
        raise DatasetError(
            f"{path}: no pose is within {max_difference} s of a depth image with a mask; the images are from "
            f"{times[0]:.3f} to {times[-1]:.3f} s, the poses from {trajectory.timestamps[0]:.3f} to "
            f"{trajectory.timestamps[-1]:.3f} s: shift the poses' times, or load it in Python with another max_difference"
        )
    if len(pairs) < len(times):
        lost = len(times) - len(pairs)
        log.warning("%s: %d of %d frames have no pose and are left out", path, lost, len(times))
    return {float(times[i]): trajectory.T_world_camera[k] for i, k in pairs}
