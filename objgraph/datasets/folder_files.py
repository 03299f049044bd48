"""The files that users write beside their images: the camera, the objects and the masks of a scan."""

import logging
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from objgraph.checked import direction, whole
from objgraph.datasets.files import (
    ColorImages,
    LazyFrames,
    decode_depth,
    decode_instances,
    fitted_ids,
    intrinsics_from,
    read_bytes,
    read_json,
    read_matrix,
)
from objgraph.datasets.mask_json import read_mask_json
from objgraph.errors import DatasetError
from objgraph.observation.frames import Frame, Instance, Scan

log = logging.getLogger(__name__)

UNUSED_MASKS = "%s: %d masks have no depth image of their name: %s; the frames are called %s"
"""A warning that the doctor takes for a fault."""
_MASKS = (".png", ".json")
_CAMERA_KEYS = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
_DISTORTION = re.compile(r"k[1-6]|p[12]|d|dist.*|coeffs")
"""Names that files of other programs give a lens's distortion."""
_CAMERA = '{"fx": 615.0, "fy": 615.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}'
_INSTANCES = '{"up_world": [0, 0, 1], "instances": {"1": "chair", "2": "table"}}'


@dataclass(frozen=True)
class Camera:
    """The depth camera as its file describes it."""

    origin: str
    """Where it comes from, for error messages."""
    matrix: Float[np.ndarray, "3 3"]
    size: tuple[int, int] | None = None
    """Width and height that the matrix is for; None where the file does not say."""
    depth_scale: float | None = None
    """Depth units a metre; None where the file does not say."""


@dataclass(frozen=True)
class FrameFiles:
    """Where a frame's images lie, and its pose."""

    depth: Path
    masks: Path
    color: Path | None
    T_world_camera: Float[np.ndarray, "4 4"]


def camera_file(folder: Path) -> Path:
    """`intrinsics.json` or `intrinsics.txt` of a scan."""
    paths = [path for path in (folder / "intrinsics.json", folder / "intrinsics.txt") if path.is_file()]
    if len(paths) != 1:
        found = "both intrinsics.json and intrinsics.txt: keep one" if paths else "no intrinsics.json"
        raise DatasetError(f"{folder}: {found}; it must read like {_CAMERA}")
    return paths[0]


def read_camera(path: Path) -> Camera:
    """The camera of a JSON file (`fx fy cx cy`, perhaps `width height depth_scale`) or of a text.

    The text is `fx fy cx cy` or a 3x3 matrix. Raises `DatasetError` for anything else, and for distortion that is not zero.
    """
    if path.suffix != ".json":
        count = len(read_bytes(path).split())
        numbers = (
            read_matrix(path, 1, 4)[0] if count == 4 else read_matrix(path, 3, 3)[[0, 1, 0, 1], [0, 1, 2, 2]]
        )
        return Camera(str(path), _matrix(*numbers))
    content = read_json(path)
    try:
        matrix = _matrix(*(float(content[key]) for key in ("fx", "fy", "cx", "cy")))
        has_size = "width" in content or "height" in content
        size = (whole(content["width"]), whole(content["height"])) if has_size else None
        if size is not None and min(size) < 1:
            raise ValueError(f"{size[0]}x{size[1]} pixels")
        depth_scale = float(content["depth_scale"]) if "depth_scale" in content else None
        _check_keys(content)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: no camera ({_reason(error)}); it must read like {_CAMERA}") from error
    return Camera(str(path), matrix, size, None if depth_scale is None else units_a_metre(depth_scale, path))


def _check_keys(content: Mapping[str, Any]) -> None:
    """Raise ValueError for what would be ignored: a depth scale under another name, distortion; zeros say nothing."""
    for key in sorted(content.keys() - set(_CAMERA_KEYS)):
        if _DISTORTION.fullmatch(key.lower()) is None:
            raise ValueError(f"{key} is not known, there are {', '.join(_CAMERA_KEYS)}: take it out")
        if np.asarray(content[key], dtype=float).any():
            raise ValueError(
                f"the lens distortion {key} is not corrected: undistort the images and take it out"
            )


def units_a_metre(depth_scale: float, origin: object) -> float:
    """The depth scale; `DatasetError` for what can be none, metres a unit among it."""
    if not (np.isfinite(depth_scale) and depth_scale >= 1):
        inverse = f": write {1 / depth_scale:g}" if 0 < depth_scale < 1 else ""
        raise DatasetError(
            f"{origin}: depth_scale {depth_scale:g} must be the depth units in a metre{inverse}"
        )
    return float(depth_scale)


def read_instances(
    path: Path, usual_up: Float[np.ndarray, "3"] | None = None
) -> tuple[Float[np.ndarray, "3"], tuple[Instance, ...]]:
    """The unit vector against gravity and the objects of `instances.json`, by rising id.

    `usual_up` counts where the file has no `up_world`. Ids of the masks that it does not name are not mapped. Raises `DatasetError`, with an example of the file,
    for what is missing or wrong.
    """
    content = read_json(path) if path.is_file() else None
    try:
        if content is None:
            raise ValueError("there is no such file")
        given = content["up_world"] if usual_up is None else content.get("up_world", usual_up)
        # up_world under another name, say
        if unknown := sorted(content.keys() - {"up_world", "instances", "by"}):
            raise ValueError(f"{unknown[0]} is not known, there are up_world, instances and by: take it out")
        up = direction(given, "up_world")
        if not isinstance(content["instances"], dict):
            raise ValueError("'instances' names no categories by id")
        instances = [_instance(key, label) for key, label in content["instances"].items()]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {_reason(error)}; it must read like {_INSTANCES}") from error
    if not instances:
        raise DatasetError(f"{path}: names no instance; it must read like {_INSTANCES}")
    return up, tuple(sorted(instances, key=lambda instance: instance.id))


def mask_paths(
    folder: Path, candidates: Mapping[str, Sequence[str]], others: Collection[str] = ()
) -> dict[str, Path]:
    """Each frame's file in `masks/`, NAME.png or NAME.json: the first that exists of those that it may be named after.

    Frames without one are left out with a warning: segmenting some of the frames is enough. Masks of no frame are warned of,
    too, but for those of `others`, images that have no depth. Raises `DatasetError` where there is no mask at all.
    """
    masks = folder / "masks"
    found: dict[str, Path] = {}
    for name, stems in candidates.items():
        path = next(
            (p for p in (masks / f"{stem}{end}" for stem in stems for end in _MASKS) if p.is_file()),
            None,
        )
        if path is not None:
            found[name] = path
    if not found:
        there = sorted(path.name for path in masks.iterdir()) if masks.is_dir() else []
        have = f"masks/ has {_few(there)}; " if there else ""
        raise DatasetError(
            f"{folder}: none of the {len(candidates)} depth images has a mask; {have}write masks/NAME.png with the depth "
            f"image's NAME (masks/{next(iter(candidates))}.png): one channel, 8 or 16 bit, a pixel's value is its object's id and 0 is none"
        )
    known = {stem for stems in candidates.values() for stem in stems}.union(others)
    unused = sorted(p.stem for p in masks.iterdir() if p.suffix in _MASKS and p.stem not in known)
    if unused:
        log.warning(UNUSED_MASKS, masks, len(unused), _few(unused), _few(list(candidates)))
    if len(found) < len(candidates):
        lost = len(candidates) - len(found)
        log.warning("%s: %d of %d frames have no mask and are left out", folder, lost, len(candidates))
    return found


def read_masks(path: Path, shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """Instance ids of one of `mask_paths`, as large as `shape`; raises `DatasetError`."""
    if path.suffix == ".json":
        return fitted_ids(read_mask_json(path, shape), path, shape)
    return decode_instances(read_bytes(path), path, shape)


def build_scan(
    folder: Path,
    files: Mapping[str, FrameFiles],
    camera: Camera,
    depth_scale: float | None,
    usual_scale: float,
) -> Scan:
    """The scan of these frames and of the folder's `instances.json`; depth as in `lazy_frames`."""
    up_world, instances = read_instances(folder / "instances.json")
    frames = lazy_frames(folder, files, camera, depth_scale, usual_scale)
    return Scan(folder.resolve().name, frames, instances, up_world)


def lazy_frames(
    folder: Path,
    files: Mapping[str, FrameFiles],
    camera: Camera,
    depth_scale: float | None,
    usual_scale: float,
) -> LazyFrames:
    """Frames read on demand from their files.

    Depth is in `depth_scale` units a metre where it is given, else in the camera's file's, else in `usual_scale`.
    """
    if depth_scale is None:
        depth_scale = camera.depth_scale or usual_scale
    units = units_a_metre(depth_scale, folder)
    colors = ColorImages()

    def read(name: str) -> Frame:
        paths = files[name]
        depth = decode_depth(read_bytes(paths.depth), paths.depth, units)
        height, width = depth.shape
        color = paths.color
        return Frame(
            name=name,
            depth=depth,
            intrinsics=intrinsics_from(camera.matrix, camera.origin, width, height, camera.size),
            T_world_camera=paths.T_world_camera,
            instances=read_masks(paths.masks, depth.shape),
            color=colors.read(color, depth.shape),
        )

    return LazyFrames(list(files), read)


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + ", ..." * (len(names) > 3)


def _matrix(fx: float, fy: float, cx: float, cy: float) -> Float[np.ndarray, "3 3"]:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _instance(key: str, category: Any) -> Instance:
    identity = int(key)
    if not 0 < identity < 2**16:
        raise ValueError(f"instance id {key} is no value of a mask (1 to 65535)")
    if not isinstance(category, str) or not category.strip():
        raise ValueError(f"instance {key} has no category")
    return Instance(identity, category.strip())


def _reason(error: Exception) -> str:
    return f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
