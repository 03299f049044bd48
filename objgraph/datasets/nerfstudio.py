"""Scans in nerfstudio's format (Record3D, Polycam and others, by `ns-process-data`), with depth and instance masks.

Expected in `root`, or in `root/SCENE`: `transforms.json` whose frames have a `depth_file_path`, the images that it names,
and two things that the format has not: `masks/NAME.png`, called as the frame's colour or depth image, and
`instances.json`; both are those of the plain folder (`folder.py`). nerfstudio's cameras look along -z with y up, its
worlds have z up, and the middle of its first pixel is at (0.5, 0.5): all of it is converted. Poses must be in metres.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.checked import inside
from objgraph.datasets.files import (
    ColorImages,
    LazyFrames,
    decode_depth,
    intrinsics_from,
    pick_folder,
    read_bytes,
    read_json,
    scan_folders,
    usable_poses,
)
from objgraph.datasets.folder_files import Camera, mask_paths, read_instances, read_masks
from objgraph.errors import DatasetError
from objgraph.observation.frames import Frame, Scan

log = logging.getLogger(__name__)

_FILE = "transforms.json"
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""An OpenCV camera's axes in an OpenGL camera's."""
_PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
_ENDINGS = (".png", ".jpg", ".jpeg")
"""Of images whose names have none, as Blender's exporters write them."""
_Z_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class _Entry:
    """One frame of the file."""

    depth: Path
    color: Path | None
    camera: Camera
    matrix: Any
    """As it was read."""


def scenes(root: Path) -> list[str]:
    """Names of the scans: `root` itself, or the folders in it."""
    return list(scan_folders(root, _FILE))


def load(root: Path, scene: str | None = None, *, stride: int = 1) -> Scan:
    """The scan in the folder `root`, or its subfolder `scene`; it has no ground truth.

    `stride` keeps every stride-th frame of those that have depth and a mask; others are left out with a warning.
    Raises `DatasetError` for what is missing or damaged, for lens distortion, for poses that are not in metres, and for
    files outside of the folder, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = pick_folder(root, _FILE, scene)
    content, units = _content(folder / _FILE)
    entries = _entries(folder, content)
    others = [Path(str(frame.get("file_path"))).stem for frame in content["frames"]]
    masks = mask_paths(folder, {name: (name, entry.depth.stem) for name, entry in entries.items()}, others)
    names = list(masks)[::stride]
    poses = usable_poses(names, lambda name: _pose(entries[name].matrix, f"{folder / _FILE}: {name}"), folder)
    up_world, instances = read_instances(folder / "instances.json", _Z_UP)
    colors = ColorImages()

    def read(name: str) -> Frame:
        entry, camera = entries[name], entries[name].camera
        depth = decode_depth(read_bytes(entry.depth), entry.depth, units)
        height, width = depth.shape
        color = entry.color
        return Frame(
            name=name,
            depth=depth,
            intrinsics=intrinsics_from(camera.matrix, camera.origin, width, height, camera.size),
            T_world_camera=poses[name],
            instances=read_masks(masks[name], depth.shape),
            color=colors.read(color, depth.shape),
        )

    return Scan(folder.resolve().name, LazyFrames(list(poses), read), instances, up_world)


def _content(path: Path) -> tuple[Mapping[str, Any], float]:
    """The file, and depth units in a metre."""
    content = read_json(path)
    if not isinstance(content, Mapping) or not isinstance(content.get("frames"), list):
        raise DatasetError(f"{path}: has no list of frames; nerfstudio's format is due")
    scale = _number(content.get("applied_scale", 1), f"{path}: applied_scale")
    if scale != 1:
        raise DatasetError(
            f"{path}: its poses were scaled by {scale:g}: export it in metres, without scaling"
        )
    unit = _number(content.get("depth_unit_scale_factor", 0.001), f"{path}: depth_unit_scale_factor")
    if unit <= 0:
        raise DatasetError(f"{path}: depth_unit_scale_factor {unit:g} must be the metres in a unit of depth")
    return content, 1 / unit


def _entries(folder: Path, content: Mapping[str, Any]) -> dict[str, _Entry]:
    """Frames that have depth, by the name of their image."""
    path, entries = folder / _FILE, {}
    for i, frame in enumerate(content["frames"]):
        origin = f"{path}: frame {i}"
        if not isinstance(frame, Mapping):
            raise DatasetError(f"{origin}: must have a file_path, a depth_file_path and a transform_matrix")
        depth = _named(folder, frame.get("depth_file_path"), origin)
        color = _named(folder, frame.get("file_path"), origin)
        if depth is None:
            continue
        name = (color or depth).stem
        if name in entries:
            raise DatasetError(
                f"{origin}: its image is called {name} as that of an earlier frame; rename one"
            )
        seen = color if color is not None and color.is_file() else None
        entries[name] = _Entry(
            depth, seen, _camera({**content, **frame}, origin), frame.get("transform_matrix")
        )
    if not entries:
        raise DatasetError(f"{path}: no frame has a depth_file_path; export the scan with depth")
    if lost := len(content["frames"]) - len(entries):
        log.warning("%s: %d frames have no depth_file_path and are left out", path, lost)
    return entries


def _named(folder: Path, name: Any, origin: str) -> Path | None:
    """A file that the folder holds, be its ending left out; None where none is named."""
    if name is None:
        return None
    try:
        path = inside(folder, name)
        others = (inside(folder, name + ending) for ending in _ENDINGS)
        return path if path.is_file() else next((other for other in others if other.is_file()), path)
    except ValueError as error:
        raise DatasetError(f"{origin}: {error}") from error


def _camera(settings: Mapping[str, Any], origin: str) -> Camera:
    """The camera of a frame's settings over the file's, its pixel centres moved to integers."""
    model = settings.get("camera_model", "OPENCV")
    listed = settings.get("distortion_params", [])
    lens = {
        f"distortion_params[{i}]": x for i, x in enumerate(listed if isinstance(listed, list) else [listed])
    }
    lens |= {key: settings.get(key, 0) for key in _DISTORTION}
    bent = [key for key, x in lens.items() if _number(x, f"{origin}: {key}") != 0]
    if model not in _PINHOLES or bent:
        what = f"camera_model {model}" if model not in _PINHOLES else f"lens distortion ({', '.join(bent)})"
        raise DatasetError(f"{origin}: {what} is not corrected: undistort the images and set k1 to p2 to 0")
    fx, cx, cy = (_number(settings.get(key), f"{origin}: {key}") for key in ("fl_x", "cx", "cy"))
    fy = _number(settings.get("fl_y", fx), f"{origin}: fl_y")
    matrix = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])
    if "w" not in settings or "h" not in settings:
        return Camera(origin, matrix)
    width, height = (int(_number(settings[key], f"{origin}: {key}")) for key in ("w", "h"))
    if min(width, height) < 1:
        raise DatasetError(f"{origin}: images of {width}x{height} pixels are none")
    return Camera(origin, matrix, (width, height))


def _pose(matrix: Any, origin: str) -> Float[np.ndarray, "4 4"]:
    """T_world_camera, OpenCV's axes."""
    try:
        T = np.array(matrix, dtype=float)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{origin}: transform_matrix holds no numbers ({error})") from error
    if T.shape not in ((4, 4), (3, 4)):
        raise DatasetError(f"{origin}: transform_matrix must be 4x4, camera to world")
    with np.errstate(all="ignore"):  # what is not finite is told of by `usable_poses`
        return np.vstack([T[:3], [0.0, 0.0, 0.0, 1.0] if len(T) == 3 else T[3]]) @ _OPENGL


def _number(value: Any, origin: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise DatasetError(f"{origin} must be a number, not {value!r}")
    return float(value)
