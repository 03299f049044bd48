"""Single scans of any LiDAR as point files, with a detector's boxes.

Expected in `root`, or in `root/SCENE`: one of `points.pcd`, `points.ply` and `points.bin` (KITTI's: x y z reflectance,
float32), metres in the LiDAR's own axes (x ahead, y left, z up, itself at the origin), and `detections.json`:
`{"boxes": [{"category": "car", "centre": [x, y, z], "size": [length, width, height], "yaw": 0.1, "score": 0.9}]}` in the
same axes. `yaw` is about z, radians from x to y, where the object faces and its length lies; `score` may be left out.

The world is the LiDAR's frame, z up.
"""

import re
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from objgraph.datasets.files import pick_folder, read_bytes, read_json, scan_folders
from objgraph.datasets.kitti import VELODYNE_AXES
from objgraph.datasets.kitti_files import read_velodyne
from objgraph.errors import DatasetError
from objgraph.observation.lidar.frame import Detection, LidarFrame

_FILE = "detections.json"
_POINTS = ("points.pcd", "points.ply", "points.bin")
_UP = np.array([0.0, 0.0, 1.0])


def frames(root: Path) -> list[str]:
    """Names of the scans: `root` itself, or the folders in it."""
    return list(scan_folders(Path(root), _FILE))


def load_frame(root: Path, name: str | None = None) -> LidarFrame:
    """The scan in the folder `root`, or its subfolder `name`, with its detections.

    Raises:
        DatasetError: there is no such scan, or one of its files is missing, empty or damaged.
    """
    folder = pick_folder(Path(root), _FILE, name)
    content = read_json(folder / _FILE)
    if not isinstance(content, Mapping) or not isinstance(content.get("boxes"), list):
        raise DatasetError(f"{folder / _FILE}: has no list of boxes")
    found = tuple(_detection(i, box, folder / _FILE) for i, box in enumerate(content["boxes"], 1))
    T_world_lidar = np.eye(4)
    T_world_lidar[:3, :3] = VELODYNE_AXES
    return LidarFrame(folder.resolve().name, _points(folder) @ VELODYNE_AXES, T_world_lidar, _UP, found)


def _points(folder: Path) -> Float[np.ndarray, "n 3"]:
    """Returns in the LiDAR's own axes, those that are not finite left out."""
    paths = [folder / name for name in _POINTS if (folder / name).is_file()]
    if len(paths) != 1:
        found = ", ".join(path.name for path in paths) or "no points"
        raise DatasetError(f"{folder}: holds {found}; it must hold one of {', '.join(_POINTS)}")
    (path,) = paths
    if path.suffix == ".bin":
        return read_velodyne(path)
    try:
        points = (_pcd if path.suffix == ".pcd" else _ply)(path)
    except (RuntimeError, ValueError, LookupError, TypeError, MemoryError) as error:
        raise DatasetError(f"{path}: no readable points ({error}); export the scan again") from error
    return points[np.isfinite(points).all(axis=1)]


def _pcd(path: Path) -> Float[np.ndarray, "n 3"]:
    head, text, body = read_bytes(path).partition(b"DATA ascii")
    fields, count = (re.search(rb"^%s(.*)" % name, head, re.MULTILINE) for name in (b"FIELDS", b"POINTS"))
    if fields is None or count is None:
        raise ValueError("no PCD header")
    if text and len(body.split()) < len(fields[1].split()) * int(count[1]):  # which open3d does not see
        raise ValueError("truncated")
    import open3d as o3d  # slow to import

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        points = np.asarray(o3d.io.read_point_cloud(str(path), format="pcd").points)
    if not len(points):
        raise ValueError("empty, truncated or without x y z")
    return points


def _ply(path: Path) -> Float[np.ndarray, "n 3"]:
    loaded = trimesh.load(BytesIO(read_bytes(path)), file_type="ply", process=False)
    points = np.asarray(getattr(loaded, "vertices", ()), float)
    if not len(points):
        raise ValueError("it has no vertices")
    return points.reshape(-1, 3)


def _detection(number: int, box: Any, path: Path) -> Detection:
    origin = f"{path}: box {number}"
    try:
        category, score = box["category"], box.get("score")
        centre, size = (np.array(box[key], float).reshape(3) for key in ("centre", "size"))
        yaw, score = float(box["yaw"]), None if score is None else float(score)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{origin}: must have category, centre, size and yaw ({error})") from error
    if not isinstance(category, str) or not category.strip():
        raise DatasetError(f"{origin}: has no category")
    if not np.isfinite([*centre, *size, yaw]).all() or size.min() <= 0:
        raise DatasetError(f"{origin}: a box with edges {size} m at {centre} is none; delete it")
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    T_world_object = np.eye(4)
    T_world_object[:3, :3] = np.column_stack([np.cross(ahead, _UP), _UP, -ahead])
    T_world_object[:3, 3] = centre
    length, width, height = size
    return Detection(number, category.strip(), T_world_object, np.array([width, height, length]), score)
