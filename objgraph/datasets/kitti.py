"""KITTI's object benchmark: LiDAR scans with pictures, a detector's boxes, and labels for the evaluation.

The layout is the benchmark's own, `training/{velodyne,calib,image_2,label_2}/NNNNNN.*`; beside it `detections/NNNNNN.txt`
in the result format that OpenPCDet and MMDetection3D write, and, where somebody segmented the pictures,
`masks/NNNNNN.png` whose values are the numbers of the detections in their file, from 1 on; empty lines and `DontCare`
do not count.

The world is the rectified frame of camera 0 (x right, y down, z ahead), as in the labels.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objgraph.datasets.files import decode_color, decode_instances, pick_scene, read_bytes
from objgraph.datasets.kitti_files import Calibration, KittiBox, read_boxes, read_calibration, read_velodyne
from objgraph.errors import DatasetError
from objgraph.observation.frames import Intrinsics
from objgraph.observation.lidar.frame import Detection, LidarFrame, Picture

CATEGORIES = {"Car": "car"}
"""Of the benchmark's types those that there are priors for."""
VELODYNE_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: right, down and ahead in the LiDAR's own axes (x ahead, y left, z up)."""


def frames(root: Path) -> list[str]:
    """Names of the frames that have a scan.

    Raises:
        DatasetError: there is no training/velodyne under `root`.
    """
    folder = Path(root) / "training" / "velodyne"
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; the root of KITTI's object benchmark holds it")
    return sorted(path.stem for path in folder.glob("*.bin"))


def load_frame(
    root: Path, name: str | None = None, *, detections: Path | None = None, masks: Path | None = None
) -> LidarFrame:
    """One frame with its detections; those of types that no prior is for are its others.

    `detections` and `masks` are folders, by default those under `root`; masks may be missing, as may the picture.

    Raises:
        DatasetError: there is no such frame, or one of its files is missing, empty or damaged.
    """
    root = Path(root)
    name = pick_scene(frames(root), name, root)
    training = root / "training"
    calibration = read_calibration(training / "calib" / f"{name}.txt")
    points = read_velodyne(training / "velodyne" / f"{name}.bin")
    T_world_lidar = calibration.T_rect_velodyne.copy()
    T_world_lidar[:3, :3] = T_world_lidar[:3, :3] @ VELODYNE_AXES
    boxes = read_boxes((detections or root / "detections") / f"{name}.txt")
    found = [detection(box, i) for i, box in enumerate(boxes, 1) if box.type in CATEGORIES]
    others = [detection(box, i) for i, box in enumerate(boxes, 1) if box.type not in CATEGORIES]
    return LidarFrame(
        name,
        points @ VELODYNE_AXES,
        T_world_lidar,
        np.array([0.0, -1.0, 0.0]),
        tuple(found),
        _picture(training, masks or root / "masks", name, calibration),
        tuple(each for each in others if not _seen_twice(each, found)),
    )


def detection_ids(root: Path, name: str) -> tuple[int, ...]:
    """Ids of the detections that `load_frame` gives, without reading the scan."""
    boxes = read_boxes(Path(root) / "detections" / f"{name}.txt")
    return tuple(i for i, box in enumerate(boxes, 1) if box.type in CATEGORIES)


def load_labels(root: Path, name: str) -> tuple[KittiBox, ...]:
    """The frame's ground truth, of all types but `DontCare`; for the evaluation alone."""
    return read_boxes(Path(root) / "training" / "label_2" / f"{name}.txt")


def detection(box: KittiBox, number: int) -> Detection:
    """A detector's line as an object to be estimated."""
    return Detection(number, CATEGORIES.get(box.type, box.type), box.T_rect_object, box.size, box.score)


def _seen_twice(other: Detection, found: Sequence[Detection]) -> bool:
    """Whether it stands in one of these: a car that was taken for a van, too, or a false alarm in it."""
    return any(each.outside(other.T_world_object[None, :3, 3])[0] <= 0 for each in found)


def _picture(training: Path, masks: Path, name: str, calibration: Calibration) -> Picture | None:
    path = training / "image_2" / f"{name}.png"
    if not path.exists():
        return None
    color = decode_color(read_bytes(path), path)
    height, width = color.shape[:2]
    K = calibration.K
    intrinsics = Intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2], width, height)
    mask = masks / f"{name}.png"
    instances = decode_instances(read_bytes(mask), mask, (height, width)) if mask.exists() else None
    return Picture(color, intrinsics, calibration.T_rect_camera, instances)
