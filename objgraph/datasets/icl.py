"""ICL-NUIM sequences (Handa et al., ICRA 2014) with object boxes from `instances.json`.

Expected in `root`, or in `root/SCENE`: `depth/N.png` (16 bit, millimetres), `pose/N.txt` (4x4, T_world_camera),
`intrinsics.txt` (3x3), `instances.json` (see `objgraph.datasets.boxes`) and, for display, `image/N.jpg` or `.png`.
Masks are cut out of the depth by the boxes, as in 7-Scenes.
"""

from pathlib import Path

from objgraph.datasets.boxes import INSTANCES, read_object_boxes, true_boxes
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

_MILLIMETRES = 1000.0


def scenes(root: Path) -> list[str]:
    """Names of the sequences: `root` itself, or the folders in it."""
    return list(scan_folders(root, "depth"))


def load(root: Path, scene: str | None = None, *, stride: int = 1) -> Scan:
    """The sequence in the folder `root`, or its subfolder `scene`; it has no ground truth.

    `stride` keeps every stride-th frame. Frames whose pose is not finite or not rigid are left out with a warning.
    Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = pick_folder(root, "depth", scene)
    objects = read_object_boxes(folder / INSTANCES)
    stems = (path.stem for path in (folder / "depth").glob("*.png"))
    names = sorted(stems, key=lambda name: (len(name), name))[::stride]
    poses = usable_poses(names, lambda name: read_matrix(folder / "pose" / f"{name}.txt", 4, 4), folder)
    camera = read_matrix(folder / "intrinsics.txt", 3, 3)
    colors = ColorImages()

    def read(name: str) -> Frame:
        path = folder / "depth" / f"{name}.png"
        depth = decode_depth(read_bytes(path), path, _MILLIMETRES)
        height, width = depth.shape
        intrinsics = intrinsics_from(camera, folder / "intrinsics.txt", width, height)
        images = (folder / "image" / f"{name}{suffix}" for suffix in (".jpg", ".png"))
        color = next((image for image in images if image.is_file()), None)
        return Frame(
            name=name,
            depth=depth,
            intrinsics=intrinsics,
            T_world_camera=poses[name],
            instances=objects.masks(depth, intrinsics, poses[name]),
            color=colors.read(color, (height, width)),
        )

    return Scan(folder.resolve().name, LazyFrames(list(poses), read), objects.instances, objects.up_world)


def boxes(root: Path, scene: str) -> dict[int, TrueBox]:
    """The true boxes of a sequence's objects, by instance id; for the evaluation alone."""
    return true_boxes(pick_folder(root, "depth", scene) / INSTANCES)
