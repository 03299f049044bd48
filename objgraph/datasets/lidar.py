"""Single scans of any LiDAR as point files, with a detector's boxes.

Expected in `root`, or in `root/SCENE`: one of `points.pcd`, `points.ply` and `points.bin` (KITTI's: x y z reflectance,
float32), metres in the LiDAR's own axes (x ahead, y left, z up, itself at the origin), and `detections.json`:
`{"boxes": [{"category": "car", "centre": [x, y, z], "size": [length, width, height], "yaw": 0.1, "score": 0.9}]}` in the
same axes. `yaw` is about z, radians from x to y, where the object faces and its length lies; `score` may be left out.

The world is the LiDAR's frame, z up.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.checked import numbers
from objgraph.datasets.files import pick_folder, read_bytes, read_json, scan_folders
from objgraph.datasets.kitti import VELODYNE_AXES
from objgraph.datasets.kitti_files import finite_returns, read_velodyne
from objgraph.datasets.pcd import parse_pcd
from objgraph.errors import DatasetError
from objgraph.geometry.mesh_data import parse_points
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
    data = read_bytes(path)
    try:
        points = parse_pcd(data) if path.suffix == ".pcd" else parse_points(data, "ply")
    except ValueError as error:
        raise DatasetError(f"{path}: no readable points ({error}); export the scan again") from error
    return finite_returns(points, path)


def _detection(number: int, box: Any, path: Path) -> Detection:
    origin = f"{path}: box {number}"
    try:
        category, score = box["category"], box.get("score")
        centre, size, (yaw,) = (numbers(box[key], n) for key, n in (("centre", 3), ("size", 3), ("yaw", 1)))
        score = None if score is None else float(numbers(score, 1)[0])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{origin}: must have category, centre, size and yaw ({error})") from error
    if not isinstance(category, str) or not category.strip():
        raise DatasetError(f"{origin}: has no category")
    if size.min() <= 0:
        raise DatasetError(f"{origin}: a box with edges {size} m at {centre} is none; delete it")
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    T_world_object = np.eye(4)
    T_world_object[:3, :3] = np.column_stack([np.cross(ahead, _UP), _UP, -ahead])
    T_world_object[:3, 3] = centre
    length, width, height = size
    return Detection(number, category.strip(), T_world_object, np.array([width, height, length]), score)
