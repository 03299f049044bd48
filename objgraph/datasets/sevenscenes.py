"""7-Scenes sequences (Shotton et al., CVPR 2013) with object boxes from `instances.json`.

Expected in `root`, or in `root/SCENE`: `frame-NNNNNN.{color.jpg,depth.png,pose.txt}` (colour may also be png),
`camera-intrinsics.txt` and `instances.json` (see `objgraph.datasets.boxes`). In a scan, a box serves to cut the object's
mask out of the depth image and for nothing else: a pixel belongs to an object where its point lies in the object's box.
The colour camera is not exactly registered to the depth camera, so colour is for display.
"""

from collections.abc import Mapping
from pathlib import Path

from objgraph.datasets.boxes import FLOOR_MARGIN, INSTANCES, read_object_boxes, true_boxes
from objgraph.datasets.files import (
    ColorImages,
    LazyFrames,
    decode_depth,
    intrinsics_from,
    pick_folder,
    read_bytes,
    read_matrix,
    scan_folders,
    usable_poses,
)
from objgraph.datasets.ground_truth import TrueBox
from objgraph.errors import DatasetError
from objgraph.observation.frames import Frame, Scan

_CAMERA = "camera-intrinsics.txt"
_MILLIMETRES = 1000.0


def scenes(root: Path) -> list[str]:
    """Names of the sequences: `root` itself, or the folders in it."""
    return list(scan_folders(root, _CAMERA))


def load(
    root: Path,
    scene: str | None = None,
    *,
    stride: int = 1,
    categories: Mapping[str, str] | None = None,
    floor_margin: float = FLOOR_MARGIN,
) -> Scan:
    """The sequence in the folder `root`, or its subfolder `scene`; it has no ground truth.

    `stride` keeps every stride-th frame. `categories` maps the boxes' labels to categories and limits the objects to
    them; by default a label is its category. Points less than `floor_margin` metres above the floor belong to no
    object, however far down its box reaches. Frames whose pose is not finite or not rigid are left out with a
    warning. Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = pick_folder(root, _CAMERA, scene)
    objects = read_object_boxes(folder / INSTANCES, categories)
    names = sorted(path.name.split(".")[0] for path in folder.glob("frame-*.depth.png"))[::stride]
    poses = usable_poses(names, lambda name: read_matrix(folder / f"{name}.pose.txt", 4, 4), folder)
    camera = read_matrix(folder / _CAMERA, 3, 3)
    colors = ColorImages()

    def read(name: str) -> Frame:
        path = folder / f"{name}.depth.png"
        depth = decode_depth(read_bytes(path), path, _MILLIMETRES)
        height, width = depth.shape
        intrinsics = intrinsics_from(camera, folder / _CAMERA, width, height)
        instances = objects.masks(depth, intrinsics, poses[name], floor_margin)
        color = next(
            (p for p in (folder / f"{name}.color.jpg", folder / f"{name}.color.png") if p.is_file()), None
        )
        return Frame(
            name=name,
            depth=depth,
            intrinsics=intrinsics,
            T_world_camera=poses[name],
            instances=instances,
            color=colors.read(color, (height, width)),
        )

    return Scan(folder.resolve().name, LazyFrames(list(poses), read), objects.instances, objects.up_world)


def boxes(root: Path, scene: str) -> dict[int, TrueBox]:
    """The true boxes of a sequence's objects, by instance id; for the evaluation alone."""
    return true_boxes(pick_folder(root, _CAMERA, scene) / INSTANCES)
