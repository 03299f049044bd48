"""7-Scenes sequences (Shotton et al., CVPR 2013) with object boxes from `instances.json`.

Expected under `root`: `SCENE/frame-NNNNNN.{color.jpg,depth.png,pose.txt}` (colour may also be png),
`camera-intrinsics.txt` and `instances.json` with the gravity direction `up` and, for each object, an oriented
box (`centre`, `rotation`, `size`) and a label. A box serves to cut the object's mask out of the depth image and
for nothing else: a pixel belongs to an object where its point lies in the object's box. The colour camera is not
exactly registered to the depth camera, so colour is for display.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from objgraph.datasets.files import (
    LazyFrames,
    decode_color,
    decode_depth,
    intrinsics_from,
    pick_scene,
    read_bytes,
    read_json,
    read_matrix,
    usable_poses,
)
from objgraph.errors import DatasetError
from objgraph.geometry.frames import transformed, transformed_back
from objgraph.observation.frames import Frame, Instance, Intrinsics, Scan

log = logging.getLogger(__name__)

_MILLIMETRES = 1000.0
_TOP_SLAB = 0.1
_BOX_ERROR = 0.02


@dataclass(frozen=True)
class _Box:
    """An oriented box that cuts an object's points out of the depth image."""

    instance: Instance
    T_world_box: Float[np.ndarray, "4 4"]
    half_size: Float[np.ndarray, "3"]


def scenes(root: Path) -> list[str]:
    """Names of the sequences under `root`."""
    if not root.is_dir():
        raise DatasetError(f"{root}: no such folder")
    return sorted(path.parent.name for path in root.glob("*/camera-intrinsics.txt"))


def load(
    root: Path,
    scene: str | None = None,
    *,
    stride: int = 1,
    categories: Mapping[str, str] | None = None,
    floor_margin: float = 0.03,
) -> Scan:
    """The sequence `scene` under `root`, or the only one there; it has no ground truth.

    `stride` keeps every stride-th frame. `categories` maps the boxes' labels to categories and limits the objects to
    them; by default a label is its category. Points less than `floor_margin` metres above the floor belong to no
    object, however far down its box reaches. Frames whose pose is not finite or not rigid are left out with a
    warning. Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = root / pick_scene(scenes(root), scene, root)
    up_world, floor_height, boxes = _read_instances(folder / "instances.json", categories)
    names = sorted(path.name.split(".")[0] for path in folder.glob("frame-*.depth.png"))[::stride]
    poses = usable_poses(names, lambda name: read_matrix(folder / f"{name}.pose.txt", 4, 4), folder)
    camera = read_matrix(folder / "camera-intrinsics.txt", 3, 3)

    def read(name: str) -> Frame:
        path = folder / f"{name}.depth.png"
        depth = decode_depth(read_bytes(path), path, _MILLIMETRES)
        height, width = depth.shape
        intrinsics = intrinsics_from(camera, folder / "camera-intrinsics.txt", width, height)
        instances = _masks(depth, intrinsics, poses[name], boxes, up_world, floor_height + floor_margin)
        color = next(
            (p for p in (folder / f"{name}.color.jpg", folder / f"{name}.color.png") if p.is_file()), None
        )
        return Frame(
            name=name,
            depth=depth,
            intrinsics=intrinsics,
            T_world_camera=poses[name],
            instances=instances,
            color=None if color is None else decode_color(read_bytes(color), color, (height, width)),
        )

    return Scan(folder.name, LazyFrames(list(poses), read), tuple(box.instance for box in boxes), up_world)


def _read_instances(
    path: Path, categories: Mapping[str, str] | None
) -> tuple[Float[np.ndarray, "3"], float, list[_Box]]:
    """Unit up vector, the floor's height along it (minus infinity where the file has none) and the boxes.

    An object's instance id is its `id` in the file plus one: 0 means no object.
    """
    content = read_json(path)
    try:
        up = np.asarray(content["up"], dtype=float).reshape(3)
        up_world = up / np.linalg.norm(up)
        floor_height = -float(content.get("floor_d", np.inf))
        objects = content["objects"]
        if categories is None:
            categories = {str(o["label"]): str(o["label"]) for o in objects}
        others = sorted({o["label"] for o in objects if o["label"] not in categories})
        boxes = [_box(o, categories[o["label"]]) for o in objects if o["label"] in categories]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: no list of boxes ({type(error).__name__}: {error})") from error
    if others:
        log.info("%s: objects left out, no category for their labels: %s", path, ", ".join(others))
    return up_world, floor_height, boxes


def _box(entry: dict[str, Any], category: str) -> _Box:
    pose = np.eye(4)
    pose[:3, :3] = np.asarray(entry["rotation"], dtype=float).reshape(3, 3)
    pose[:3, 3] = np.asarray(entry["centre"], dtype=float).reshape(3)
    size = np.asarray(entry["size"], dtype=float).reshape(3)
    # hand-placed boxes are off by centimetres: without a margin a table's top may lie just above its box
    return _Box(Instance(int(entry["id"]) + 1, category), pose, size / 2 + _BOX_ERROR)


def _masks(
    depth: Float[np.ndarray, "h w"],
    intrinsics: Intrinsics,
    T_world_camera: Float[np.ndarray, "4 4"],
    boxes: list[_Box],
    up_world: Float[np.ndarray, "3"],
    lowest: float,
) -> Int[np.ndarray, "h w"]:
    """Each pixel's instance: the box that its point lies in.

    Chairs stand under tables, so boxes overlap: a point close under a box's top is that box's (the table's
    top, not the chair's middle), any other the smallest box's (the chair's seat, not the table's inside).
    """
    v, u = np.nonzero(depth > 0)
    p_camera = intrinsics.backproject(u, v) * depth[v, u, None]
    p_world = transformed(T_world_camera, p_camera)
    candidates = p_world @ up_world > lowest
    v, u, p_world = v[candidates], u[candidates], p_world[candidates]
    ids = np.zeros(len(p_world), dtype=np.int32)
    by_volume = sorted(boxes, key=lambda box: float(box.half_size.prod()))
    p_boxes = [transformed_back(box.T_world_box, p_world) for box in by_volume]
    inside = [
        (np.abs(p_box) < box.half_size).all(axis=1) for box, p_box in zip(by_volume, p_boxes, strict=True)
    ]
    for box, mine in zip(reversed(by_volume), reversed(inside), strict=True):
        ids[mine] = box.instance.id
    for box, p_box, mine in zip(by_volume, p_boxes, inside, strict=True):
        ids[mine & (p_box[:, 2] > box.half_size[2] - _TOP_SLAB)] = box.instance.id
    masks = np.zeros(depth.shape, dtype=np.int32)
    masks[v, u] = ids
    return masks
