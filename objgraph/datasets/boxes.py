"""Scans whose objects are known by oriented boxes (`instances.json`): masks cut out of the depth, and true boxes.

The file has the direction `up`, the floor's `floor_d` and, for each object, a box (`centre`, `rotation`, whose columns
are its axes: sideways, the way the object faces, up; `size` along them), a `label` and how much of it was seen,
`quality`. A scan holds what cuts the masks; an object's true pose and size are given apart from it, by `true_boxes`,
for the evaluation alone.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from objgraph.checked import direction, numbers, whole
from objgraph.datasets.files import read_json, rigid_or_reason
from objgraph.datasets.ground_truth import TrueBox
from objgraph.errors import DatasetError
from objgraph.geometry.frames import transformed, transformed_back
from objgraph.observation.frames import Instance, Intrinsics

log = logging.getLogger(__name__)

INSTANCES = "instances.json"
FLOOR_MARGIN = 0.03
"""Points less than this above the floor belong to no object, metres."""
_TOP_SLAB = 0.1
_BOX_ERROR = 0.02
_BOX_FROM_OBJECT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Columns: the object's x (sideways), y (up) and z (away from its front) in the box's axes."""
_SQUARE = 1e-2
"""By which the products of a box' axes may be off, as text rounds them."""
_HALF_TURNS = ("table",)
"""Which way these face is a convention of whoever drew the box."""


@dataclass(frozen=True)
class ObjectBox:
    """An oriented box about an object."""

    instance: Instance
    T_world_box: Float[np.ndarray, "4 4"]
    size: Float[np.ndarray, "3"]
    """Along the box's axes, metres."""
    quality: str

    @property
    def half_size(self) -> Float[np.ndarray, "3"]:
        """Of what it cuts out: boxes placed by hand are off by centimetres, and a table's top may lie just above its own."""
        return self.size / 2 + _BOX_ERROR

    def truth(self) -> TrueBox:
        """In the object's frame (y up, front at -z); raises DatasetError where the box' axes are no rotation."""
        T_world_box = rigid_or_reason(self.T_world_box)
        if isinstance(T_world_box, str):
            raise DatasetError(f"object {self.instance.id}: its box has no usable pose: {T_world_box}")
        T_world_object = T_world_box.copy()
        T_world_object[:3, :3] = T_world_box[:3, :3] @ _BOX_FROM_OBJECT
        symmetry = 2 if self.instance.category in _HALF_TURNS else 1
        return TrueBox.of(T_world_object, self.size[[0, 2, 1]], symmetry, self.quality)


@dataclass(frozen=True)
class Boxes:
    """What `instances.json` says."""

    up_world: Float[np.ndarray, "3"]
    floor_height: float
    """Along `up_world`; minus infinity where the file has none."""
    boxes: tuple[ObjectBox, ...]

    @property
    def instances(self) -> tuple[Instance, ...]:
        return tuple(box.instance for box in self.boxes)

    def masks(
        self,
        depth: Float[np.ndarray, "h w"],
        intrinsics: Intrinsics,
        T_world_camera: Float[np.ndarray, "4 4"],
        floor_margin: float = FLOOR_MARGIN,
    ) -> Int[np.ndarray, "h w"]:
        """Each pixel's instance: the box that its point lies in, 0 where none.

        Chairs stand under tables, so boxes overlap: a point close under a box's top is that box's (the table's
        top, not the chair's middle), any other the smallest box's (the chair's seat, not the table's inside).
        """
        v, u = np.nonzero(depth > 0)
        p_camera = intrinsics.backproject(u, v) * depth[v, u, None]
        p_world = transformed(T_world_camera, p_camera)
        candidates = p_world @ self.up_world > self.floor_height + floor_margin
        v, u, p_world = v[candidates], u[candidates], p_world[candidates]
        ids = np.zeros(len(p_world), dtype=np.int32)
        by_volume = sorted(self.boxes, key=lambda box: float(box.half_size.prod()))
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


def read_object_boxes(path: Path, categories: Mapping[str, str] | None = None) -> Boxes:
    """`categories` maps labels to categories and limits the objects to them; by default a label is its category.

    An object's instance id is its `id` in the file plus one: 0 means no object.

    Raises:
        DatasetError: the file is missing or malformed.
    """
    content = read_json(path)
    try:
        up = direction(content["up"], "up")
        floor_height = -float(numbers(content["floor_d"], 1)[0]) if "floor_d" in content else -np.inf
        objects = content["objects"]
        if not all(isinstance(o["label"], str) for o in objects):
            raise ValueError("a label is no text")
        if categories is None:
            categories = {o["label"]: o["label"] for o in objects}
        others = sorted({o["label"] for o in objects if o["label"] not in categories})
        boxes = tuple(_box(o, categories[o["label"]]) for o in objects if o["label"] in categories)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: no list of boxes ({type(error).__name__}: {error})") from error
    if others:
        log.info("%s: objects left out, no category for their labels: %s", path, ", ".join(others))
    return Boxes(up, floor_height, boxes)


def true_boxes(path: Path) -> dict[int, TrueBox]:
    """By instance id; for the evaluation alone. Raises DatasetError as `read_object_boxes` does."""
    return {box.instance.id: box.truth() for box in read_object_boxes(path).boxes}


def _box(entry: dict[str, Any], category: str) -> ObjectBox:
    pose = np.eye(4)
    pose[:3, :3] = numbers(entry["rotation"], 3, 3)
    if np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() > _SQUARE:
        raise ValueError(f"the box of object {entry['id']} has axes that are no unit vectors at right angles")
    pose[:3, 3] = numbers(entry["centre"], 3)
    size = numbers(entry["size"], 3)
    if not (size > 0).all():
        raise ValueError(f"a box with edges {size}")
    return ObjectBox(
        Instance(whole(entry["id"]) + 1, category), pose, size, str(entry.get("quality", "full"))
    )
