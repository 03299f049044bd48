"""ScanNet scans, exported to folders or straight from the `.sens` file, with Scan2CAD's ground truth beside them.

Dai et al., "ScanNet", CVPR 2017. Expected under `root`: `scans/SCENE/` with `color/N.jpg`, `depth/N.png`,
`pose/N.txt` and `intrinsic/intrinsic_depth.txt` (as ScanNet's SensReader exports them), or `SCENE.sens` in
their place; masks in `instance-filt/N.png` or `SCENE_2d-instance-filt.zip` (value = objectId + 1);
`SCENE.aggregation.json` or `SCENE_vh_clean.aggregation.json` for the labels; `SCENE.txt` for sizes, if it is
there. Colour and masks of another resolution are resized to the depth image's.
"""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objgraph.datasets.files import (
    LazyFrames,
    decode_instances,
    pick_scene,
    usable_poses,
)
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth, LazyTruth
from objgraph.datasets.scan2cad import load_aligned_models, match_models
from objgraph.datasets.scannet_files import Recording, mask_reader, open_recording, read_labels
from objgraph.errors import DatasetError
from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Frame, FrameSource, Instance
from objgraph.priors.categories import category_of

log = logging.getLogger(__name__)

NO_OBJECTS = frozenset(
    ("wall", "floor", "ceiling", "window", "windowsill", "door", "doorframe", "curtain", "shower curtain")
    + (
        "shower curtain rod",
        "blinds",
        "stairs",
        "stair rail",
        "rail",
        "railing",
        "handrail",
        "pillar",
        "column",
    )
    + (
        "structure",
        "ledge",
        "rug",
        "carpet",
        "mat",
        "poster",
        "picture",
        "light",
        "pipe",
        "unknown",
        "remove",
    )
)
"""Labels of the room itself, of sheets and of nothing in particular; left out unless asked for."""

_MATCH_FRAMES = 60
_MATCH_STRIDE = 8


def scenes(root: Path) -> list[str]:
    """Names of the scans under `root`."""
    folder = _scans(root)
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


def load(
    root: Path,
    scene: str | None = None,
    *,
    stride: int = 1,
    categories: Mapping[str, str] | None = None,
    scan2cad: Path | None = None,
    shapenet: Path | None = None,
) -> AnnotatedScan:
    """The scan `scene` under `root`, or the only one there.

    `stride` keeps every stride-th frame. `categories` maps ScanNet's labels to categories and limits the objects to
    them; by default every label but `NO_OBJECTS` is mapped, by `category_of`. `scan2cad` (folder of
    `full_annotations.json`) and `shapenet` are by default the folders of these names beside `root`; without
    annotations the ground truth is empty. Frames whose pose is missing, not finite or not rigid are left out
    with a warning. Raises `DatasetError` for what is missing or damaged, here or when a frame is read.
    """
    if stride < 1:
        raise DatasetError(f"stride {stride}: must be 1 or more")
    folder = _scans(root) / pick_scene(scenes(root), scene, _scans(root))
    recording = open_recording(folder)
    poses = usable_poses(recording.names[::stride], recording.pose, folder)
    instances = _instances(read_labels(folder), categories, folder.name)
    frames = LazyFrames(list(poses), _frame_reader(recording, poses, folder))
    annotations = (scan2cad or root.parent / "scan2cad") / "full_annotations.json"
    meshes = shapenet or root.parent / "shapenet"
    return AnnotatedScan(
        name=folder.name,
        frames=frames,
        instances=instances,
        up_world=np.array([0.0, 0.0, 1.0]),
        ground_truth=LazyTruth(lambda: _ground_truth(frames, instances, annotations, meshes, folder.name)),
    )


def _scans(root: Path) -> Path:
    folder = root / "scans"
    if not folder.is_dir():
        raise DatasetError(f"{root}: holds no folder scans/; give the folder that holds ScanNet's scans/")
    return folder


def _instances(
    labels: dict[int, str], categories: Mapping[str, str] | None, scene: str
) -> tuple[Instance, ...]:
    """The objects to map; a mask's value is the objectId plus one."""
    if categories is None:
        categories = {label: category_of(label) for label in set(labels.values()) - NO_OBJECTS}
    others = sorted({label for label in labels.values() if label not in categories})
    if others:
        log.info("%s: objects left out, no category for their labels: %s", scene, ", ".join(others))
    return tuple(
        Instance(object_id + 1, categories[label])
        for object_id, label in sorted(labels.items())
        if label in categories
    )


def _frame_reader(
    recording: Recording, poses: dict[str, Float[np.ndarray, "4 4"]], folder: Path
) -> Callable[[str], Frame]:
    """A function that reads the frame of a name."""
    mask = mask_reader(folder)

    def read(name: str) -> Frame:
        depth = recording.depth(name)
        data, origin = mask(name)
        return Frame(
            name=name,
            depth=depth,
            intrinsics=recording.intrinsics(depth.shape),
            T_world_camera=poses[name],
            instances=decode_instances(data, origin, depth.shape),
            color=recording.color(name, depth.shape),
        )

    return read


def _ground_truth(
    frames: FrameSource, instances: tuple[Instance, ...], annotations: Path, shapenet: Path, scene: str
) -> dict[int, GroundTruth]:
    """The annotated model of each instance, found by where the masked depth lies."""
    models = load_aligned_models(annotations, shapenet, scene)
    if not models:
        return {}
    points: dict[int, list[np.ndarray]] = {instance.id: [] for instance in instances}
    for index in np.unique(np.linspace(0, len(frames) - 1, _MATCH_FRAMES).astype(int)):
        frame = frames[int(index)]
        for instance_id, p_world in _sparse_points(frame).items():
            if instance_id in points:
                points[instance_id].append(p_world)
    truth = match_models(
        models,
        {i: np.concatenate(parts) for i, parts in points.items() if parts},
        {instance.id: instance.category for instance in instances},
    )
    unmatched = [instance.id for instance in instances if instance.id not in truth]
    if unmatched:
        log.info("%s: instances without an annotated model: %s", scene, unmatched)
    return truth


def _sparse_points(frame: Frame) -> dict[int, Float[np.ndarray, "n 3"]]:
    """World points of every few masked pixels, by instance."""
    v, u = np.mgrid[: frame.depth.shape[0] : _MATCH_STRIDE, : frame.depth.shape[1] : _MATCH_STRIDE]
    depth, ids = frame.depth[v, u], frame.instances[v, u]
    seen = (depth > 0) & (ids > 0)
    p_camera = frame.intrinsics.backproject(u[seen], v[seen]) * depth[seen][:, None]
    p_world = transformed(frame.T_world_camera, p_camera)
    return {int(i): p_world[ids[seen] == i] for i in np.unique(ids[seen])}
