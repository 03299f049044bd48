"""Scenes of the BOP challenge (Hodan et al., ECCV 2018) whose cameras have poses in a world.

Expected in `root`, or in `root/SCENE`: `scene_camera.json` (with `cam_R_w2c` and `cam_t_w2c`), `scene_gt.json`,
`depth/NNNNNN.png`, `mask_visib/NNNNNN_MMMMMM.png`, for display `rgb/NNNNNN.png` or `.jpg`, and, there or in the folder
above, `instances.json` as that of the plain folder (`folder.py`) with object ids for instance ids. Of the ground truth
masks and object ids are read, never a pose: which masks are of one object is told by their points in the world.
"""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.checked import numbers, whole
from objgraph.datasets.files import (
    ColorImages,
    LazyFrames,
    decode_depth,
    decode_mask,
    pick_folder,
    read_bytes,
    read_json,
    rigid_or_reason,
    scan_folders,
)
from objgraph.datasets.folder_files import read_instances
from objgraph.errors import DatasetError
from objgraph.observation.frames import Frame, Instance, Intrinsics, Scan

log = logging.getLogger(__name__)

_FILE = "scene_camera.json"
_MILLIMETRES = 1000.0


@dataclass(frozen=True)
class _View:
    """One image of a scene."""

    K: Float[np.ndarray, "3 3"]
    units: float
    """Of depth, in a metre."""
    T_world_camera: Float[np.ndarray, "4 4"]
    objects: Mapping[int, int]
    """Object id by number of the mask, of those that are mapped."""


def scenes(root: Path) -> list[str]:
    """Names of the scenes: `root` itself, or the folders in it."""
    return list(scan_folders(root, _FILE))


def load(root: Path, scene: str | None = None, *, stride: int = 1) -> Scan:
    """The scene in the folder `root`, or its subfolder `scene`; its poses of objects are not read.

    `stride` keeps every stride-th image. An object id that no image has twice is one object; of others, masks of
    different images are one object where their points meet in the world, for which all images are read.
    Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = pick_folder(root, _FILE, scene)
    own = folder / "instances.json"
    up_world, named = read_instances(own if own.is_file() else folder.resolve().parent / "instances.json")
    categories = {instance.id: instance.category for instance in named}
    views = _views(folder, categories, stride)
    colors = ColorImages()
    local = LazyFrames(list(views), lambda name: _frame(folder, name, views[name], colors))
    ids, objects = _linked(local, views)
    instances = tuple(Instance(number, categories[obj]) for number, obj in objects.items())

    def read(name: str) -> Frame:
        frame = _frame(folder, name, views[name], colors)
        table = np.zeros(max(views[name].objects, default=-1) + 2, np.int32)
        for number in views[name].objects:
            table[number + 1] = ids.get((name, number), 0)
        return replace(frame, instances=table[frame.instances])

    return Scan(folder.resolve().name, LazyFrames(list(views), read), instances, up_world)


def _views(folder: Path, categories: Mapping[int, str], stride: int) -> dict[str, _View]:
    """Every stride-th image that has ground truth, by name."""
    cameras, truth = (_by_number(folder / name) for name in (_FILE, "scene_gt.json"))
    views = {}
    for number in sorted(cameras.keys() & truth.keys())[::stride]:
        origin = f"{folder / _FILE}: image {number}"
        K, T, scale = _camera(cameras[number], origin)
        try:
            objects = {i: whole(each["obj_id"]) for i, each in enumerate(truth[number])}
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError(
                f"{folder / 'scene_gt.json'}: image {number} is no list of objects with an obj_id"
            ) from error
        kept = {i: obj for i, obj in objects.items() if obj in categories}
        views[f"{number:06d}"] = _View(K, _MILLIMETRES / scale, T, kept)
    if not any(view.objects for view in views.values()):
        raise DatasetError(f"{folder}: no image shows an object that instances.json names")
    return views


def _by_number(path: Path) -> dict[int, Any]:
    content = read_json(path)
    try:
        return {int(key): value for key, value in content.items()}
    except (AttributeError, ValueError) as error:
        raise DatasetError(f"{path}: must have an entry for each image by its number") from error


def _camera(entry: Any, origin: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Matrix, T_world_camera in metres, and millimetres in a unit of depth."""
    if not isinstance(entry, Mapping) or "cam_R_w2c" not in entry or "cam_t_w2c" not in entry:
        raise DatasetError(
            f"{origin} has no cam_R_w2c and cam_t_w2c: BOP scenes without camera poses cannot be mapped"
        )
    try:
        K = numbers(entry["cam_K"], 3, 3)
        T_camera_world = np.eye(4)
        T_camera_world[:3, :3] = numbers(entry["cam_R_w2c"], 3, 3)
        T_camera_world[:3, 3] = numbers(entry["cam_t_w2c"], 3) / _MILLIMETRES
        (scale,) = numbers(entry.get("depth_scale", 1.0), 1)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{origin}: cam_K, cam_R_w2c, cam_t_w2c or depth_scale is damaged ({error})"
        ) from error
    if min(K[0, 0], K[1, 1]) <= 0 or scale <= 0:
        raise DatasetError(f"{origin}: no camera (fx {K[0, 0]:g}, fy {K[1, 1]:g}, depth_scale {scale:g})")
    pose = rigid_or_reason(T_camera_world)
    if isinstance(pose, str):
        raise DatasetError(f"{origin}: its pose cannot be used: {pose}")
    return K, np.linalg.inv(pose), float(scale)


def _frame(folder: Path, name: str, view: _View, colors: ColorImages) -> Frame:
    """With masks' numbers, from 1 on, for instances."""
    path = folder / "depth" / f"{name}.png"
    depth = decode_depth(read_bytes(path), path, view.units)
    height, width = depth.shape
    instances = np.zeros(depth.shape, np.int32)
    for number in view.objects:
        mask = folder / "mask_visib" / f"{name}_{number:06d}.png"
        instances[decode_mask(read_bytes(mask), mask, depth.shape) > 0] = number + 1
    images = (folder / "rgb" / f"{name}{suffix}" for suffix in (".png", ".jpg"))
    color = next((image for image in images if image.is_file()), None)
    return Frame(
        name=name,
        depth=depth,
        intrinsics=Intrinsics(view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2], width, height),
        T_world_camera=view.T_world_camera,
        instances=instances,
        color=colors.read(color, depth.shape),
    )


def _linked(
    frames: LazyFrames, views: Mapping[str, _View]
) -> tuple[dict[tuple[str, int], int], dict[int, int]]:
    """The id of each image's mask by its number, and each id's object id."""
    single = {obj for view in views.values() for obj in view.objects.values()} - _repeated(views.values())
    numbers = {obj: i for i, obj in enumerate(sorted(single), 1)}
    ids = {
        (name, i): numbers[obj]
        for name, view in views.items()
        for i, obj in view.objects.items()
        if obj in single
    }
    objects = {number: obj for obj, number in numbers.items()}
    if _repeated(views.values()):
        from objgraph.segment.link import LinkConfig, link  # its package loads torch

        others = [
            {i + 1: str(obj) for i, obj in view.objects.items() if obj not in single}
            for view in views.values()
        ]
        found = link(frames, others, LinkConfig(voxel=0.02, frames=1, border=1))
        if lost := sum(map(len, others)) - len(found.ids):
            log.warning("%d masks show too little of one of several like objects and are left out", lost)
        ids |= {(frames.names[k], i - 1): len(single) + number for (k, i), number in found.ids.items()}
        objects |= {len(single) + number: int(obj) for number, obj in found.categories.items()}
    return ids, objects


def _repeated(views: Iterable[_View]) -> set[int]:
    """Object ids that an image shows more than once."""
    shown = (list(view.objects.values()) for view in views)
    return {obj for objects in shown for obj in objects if objects.count(obj) > 1}
