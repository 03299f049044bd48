"""A posed RGB-D scan in a folder that anybody can write, with instance masks.

Expected in `root`, or in `root/SCENE`: `depth/NAME.png` (16 bit), `masks/NAME.png` (8 or 16 bit, a pixel's
instance id, 0 for none), `intrinsics.json` or `intrinsics.txt`, `poses.txt` (a line `NAME tx ty tz qx qy qz qw` each,
T_world_camera) or `pose/NAME.txt` (4x4, T_world_camera), `instances.json` (which way is up, and the category of
each id), and, for display, `color/NAME.jpg` or `.png`. All images of a frame show the same view: depth is
registered to the camera of the intrinsics, and nothing is distorted.
"""

import logging
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objgraph.datasets.files import (
    LazyFrames,
    check_proportions,
    image_shape,
    intrinsics_from,
    pick_folder,
    read_matrix,
    scan_folders,
    usable_poses,
)
from objgraph.datasets.folder_files import (
    Camera,
    FrameFiles,
    build_scan,
    camera_file,
    lazy_frames,
    mask_paths,
    read_camera,
)
from objgraph.datasets.trajectory import MAX_DIFFERENCE, associate, read_labelled_poses
from objgraph.errors import DatasetError
from objgraph.observation.frames import Scan

log = logging.getLogger(__name__)

_MILLIMETRES = 1000.0
_TIME = re.compile(r"\d+\.\d+(e[+-]\d+)?")


def scenes(root: Path) -> list[str]:
    """Names of the scans: `root` itself, or the folders in it."""
    return list(scan_folders(root, "depth"))


def load(
    root: Path,
    scene: str | None = None,
    *,
    stride: int = 1,
    trajectory: Path | None = None,
    depth_scale: float | None = None,
    max_difference: float = MAX_DIFFERENCE,
) -> Scan:
    """The scan in the folder `root`, or its subfolder `scene`; it has no ground truth.

    `stride` keeps every stride-th frame of those that have a mask. `trajectory` is read in place of `poses.txt`;
    where frames are named by their timestamps, a line belongs to the frame whose time is nearest and at most
    `max_difference` seconds away. `depth_scale` (units a metre) overrules the `depth_scale` of `intrinsics.json`;
    without either it is 1000. Frames without a mask or a pose are left out with a warning. Raises `DatasetError` for
    what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = pick_folder(root, "depth", scene)
    stems = _stems(folder)
    masks = mask_paths(folder, {name: (name,) for name in stems})
    files, camera = _files(folder, list(masks)[::stride], masks, trajectory, max_difference)
    return build_scan(folder, files, camera, depth_scale, _MILLIMETRES)


def frames_with_masks(folder: Path, masks: Mapping[str, Path], trajectory: Path | None = None) -> LazyFrames:
    """The frames of these names that have a pose, before there is an `instances.json`; the masks may be written later.

    Raises:
        DatasetError: see `load`; or images are of a size that is none for the camera, or for each other.
    """
    files, camera = _files(folder, list(masks), masks, trajectory, MAX_DIFFERENCE)
    for paths in files.values():
        height, width = image_shape(paths.depth, paths.depth)
        intrinsics_from(camera.matrix, camera.origin, width, height, camera.size)
        if paths.color is not None:  # masks are made as large as it is
            shape = image_shape(paths.color, paths.color)
            check_proportions("colour image", paths.color, shape, (height, width))
    return lazy_frames(folder, files, camera, None, _MILLIMETRES)


def _stems(folder: Path) -> list[str]:
    """Names of the frames, in their order."""
    stems = [path.stem for path in (folder / "depth").glob("*.png")]
    if not stems:
        raise DatasetError(f"{folder / 'depth'}: holds no NAME.png; write depth as 16-bit images there")
    return sorted(stems, key=lambda name: (len(name), name))


def _files(
    folder: Path,
    names: list[str],
    masks: Mapping[str, Path],
    trajectory: Path | None,
    max_difference: float,
) -> tuple[dict[str, FrameFiles], Camera]:
    camera = read_camera(camera_file(folder))
    poses = _poses(folder, names, trajectory, max_difference)
    files = {
        name: FrameFiles(folder / "depth" / f"{name}.png", masks[name], color_path(folder, name), pose)
        for name, pose in poses.items()
    }
    return files, camera


def _poses(
    folder: Path, names: list[str], trajectory: Path | None, max_difference: float
) -> dict[str, Float[np.ndarray, "4 4"]]:
    """T_world_camera by frame, from the trajectory or the folder of matrices."""
    path = trajectory or folder / "poses.txt"
    matrices = folder / "pose"
    if trajectory is None and path.is_file() == matrices.is_dir():
        found = (
            "both poses.txt and pose/: keep one" if path.is_file() else "no poses.txt (nor a folder pose/)"
        )
        raise DatasetError(f"{folder}: {found}; a line 'NAME tx ty tz qx qy qz qw' says where a camera was")
    if trajectory is None and matrices.is_dir():
        return usable_poses(names, lambda name: read_matrix(matrices / f"{name}.txt", 4, 4), folder)
    labelled = read_labelled_poses(path)
    labels = _labels(names, list(labelled), max_difference)
    if not labels:
        raise DatasetError(
            f"{path}: no line belongs to a frame: the frames are called {', '.join(names[:3])}, .., the lines begin "
            f"with {', '.join(list(labelled)[:3])}, ..; begin each line with its frame's name, "
            f"or with a time within {max_difference:g} s of a frame that is named by its own (in Python: max_difference)"
        )
    if len(labels) < len(names):
        lost = [name for name in names if name not in labels]
        log.warning(
            "%s: %d frames have no pose and are left out: %s, ..", path, len(lost), ", ".join(lost[:3])
        )
    return {name: labelled[labels[name]] for name in names if name in labels}


def _labels(names: list[str], labels: list[str], max_difference: float) -> dict[str, str]:
    """The label of each frame that has one: its name, else the first of its number, or its nearest time.

    Times count only where frames are named by times: frame 000001 is not the pose at one second.
    """
    by_number = {int(label): label for label in reversed(labels) if label.isdecimal()}
    numbers = {name: int(name) for name in names if name.isdecimal()}
    same = {name: by_number[number] for name, number in numbers.items() if number in by_number}
    same |= {name: name for name in set(names).intersection(labels)}
    timed = [name for name in names if _TIME.fullmatch(name)]
    times = [label for label in labels if _TIME.fullmatch(label)]
    pairs = associate(np.array(timed, dtype=float), np.array(times, dtype=float), max_difference)
    return same | {timed[i]: times[k] for i, k in pairs}


def color_path(folder: Path, name: str) -> Path | None:
    endings = (ending for low in (".jpg", ".png", ".jpeg") for ending in (low, low.upper()))
    paths = (folder / "color" / f"{name}{ending}" for ending in endings)
    return next((path for path in paths if path.is_file()), None)
