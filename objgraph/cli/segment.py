"""What the command line does with colour images: `objgraph segment` writes the masks that are missing."""

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from rich.console import Console
from rich.progress import track

from objgraph.atomic import write_file, write_folder
from objgraph.checked import direction
from objgraph.cli.run_config import Topics
from objgraph.datasets.bag.load import Recording, pick_bag
from objgraph.datasets.files import LazyFrames, decode_color, image_shape, pick_folder, read_bytes, read_json
from objgraph.datasets.folder import color_path, frames_with_masks
from objgraph.datasets.kitti import CATEGORIES, frames
from objgraph.datasets.kitti_files import read_boxes
from objgraph.errors import DatasetError, SegmentationError
from objgraph.segment.link import link
from objgraph.segment.mask2former import Segmenter
from objgraph.segment.masks import detection_masks, instance_masks

log = logging.getLogger(__name__)

_Boxes = Mapping[int, tuple[str, Float[np.ndarray, "4"]]]
"""Category and (left, top, right, bottom) in pixels, by detection."""
_BY = "objgraph segment"
"""What `instances.json` says of who wrote it: that one may be replaced, be it of a run that was killed."""


@dataclass(frozen=True)
class SegmentCommand:
    """Segment the colour images of a data set that has no masks yet."""

    root: Path
    """The data set's folder, or the bag; `masks` is written into the folder, or beside the bag."""
    weights: str = "facebook/mask2former-swin-small-coco-instance"
    """Folder of a Mask2Former checkpoint, or its name in the local cache."""
    dataset: Literal["folder", "bag", "kitti"] = "folder"
    up: tuple[float, float, float] | None = None
    """Of folder and bag: the direction against gravity in the poses' world; by default what `instances.json` says, or z
    where a bag's world is called map, odom or world."""
    stride: int = 1
    """Of folder and bag: segment every stride-th frame."""
    trajectory: Path | None = None
    """Of folder and bag: trajectory file in the TUM format in place of their own."""
    topic: Topics = field(default_factory=Topics)
    """Of a bag, in place of guesses."""
    device: str = "cpu"


@dataclass(frozen=True)
class _Unmasked:
    """A scan without masks."""

    folder: Path
    """Where its masks are to lie."""
    names: list[str]
    """Of the frames to be segmented, which have poses."""
    color: Callable[[str], UInt8[np.ndarray, "h w 3"]]
    frames: Callable[[Mapping[str, Path]], LazyFrames]
    """By the masks of their names."""
    up_world: Float[np.ndarray, "3"] | None = None
    """Where it is known without being told."""


def run_segment(command: SegmentCommand, console: Console) -> Path:
    """Write `masks`, and of a folder or bag `instances.json`; both appear whole or not at all.

    Raises:
        SegmentationError: transformers or the weights are missing, or nothing was found.
        DatasetError: images, the camera or poses are missing or damaged, or there are masks or named instances already.
    """
    if command.stride < 1:
        raise DatasetError(f"--stride {command.stride}: must be 1 or more")
    if command.dataset == "kitti":
        detected, masks = _detected(command.root), _free(command.root / "masks")
        segmenter = Segmenter.load(command.weights, device=command.device)
        write_folder(masks, lambda folder: _kitti(detected, folder, segmenter))
    else:
        scan = _bag(command) if command.dataset == "bag" else _folder(command)
        masks, up = _free(scan.folder / "masks"), _up(command, scan)
        segmenter = Segmenter.load(command.weights, device=command.device)
        write_folder(masks, lambda folder: _scan(scan, folder, segmenter, up))
    console.print(f"written to {masks}", markup=False)
    return masks


def _free(masks: Path) -> Path:
    """The folder that is to be written; raises DatasetError where it is there."""
    if masks.exists():
        raise DatasetError(f"{masks}: already there; remove it to segment the images again")
    return masks


def _folder(command: SegmentCommand) -> _Unmasked:
    """Camera, poses and the images' sizes are looked at now: what is wrong with them is told before hours of segmenting."""
    root = pick_folder(command.root, "depth", None)
    stems = (path.stem for path in (root / "depth").glob("*.png"))
    colors = {name: color_path(root, name) for name in sorted(stems, key=lambda name: (len(name), name))}
    images = {name: path for name, path in colors.items() if path is not None}
    if not images:
        raise DatasetError(
            f"{root / 'color'}: holds no NAME.jpg or .png of a depth image's NAME: nothing to segment"
        )
    masks = {name: root / "masks" / f"{name}.png" for name in list(images)[:: command.stride]}
    names = list(frames_with_masks(root, masks, command.trajectory).names)
    return _Unmasked(
        root,
        names,
        lambda name: decode_color(read_bytes(images[name]), images[name]),
        lambda masks: frames_with_masks(root, masks, command.trajectory),
    )


def _bag(command: SegmentCommand) -> _Unmasked:
    path = pick_bag(command.root, None)
    bag = Recording.read(path, trajectory=command.trajectory, **command.topic.options())
    names = [name for name in bag.colors if name in bag.poses][:: command.stride]
    if not names:
        raise DatasetError(
            f"{path}: no depth image has a pose and a colour image near in time: nothing to segment"
        )

    def color(name: str) -> UInt8[np.ndarray, "h w 3"]:
        image = bag.color(name)
        assert image is not None  # of those that have one
        return image

    return _Unmasked(
        path.parent,
        names,
        color,
        bag.frames,
        bag.up_world,
    )


def _detected(root: Path) -> dict[str, tuple[Path, _Boxes]]:
    """Picture and detections of each frame that has a picture; all are looked at now, as those of a folder are."""
    found = {}
    for name in frames(root):
        picture = root / "training" / "image_2" / f"{name}.png"
        if not picture.exists():
            log.warning("%s: no such picture, frame %s is left out", picture, name)
            continue
        image_shape(picture, picture)
        boxes = enumerate(read_boxes(root / "detections" / f"{name}.txt"), 1)
        found[name] = (
            picture,
            {i: (CATEGORIES[box.type], box.image_box) for i, box in boxes if box.type in CATEGORIES},
        )
    if not found:
        raise DatasetError(f"{root / 'training' / 'image_2'}: holds no picture of a scan: nothing to segment")
    return found


def _kitti(detected: Mapping[str, tuple[Path, _Boxes]], out: Path, segmenter: Segmenter) -> None:
    """Each detection gets the mask that fills its image box best."""
    for name, (picture, boxes) in track(detected.items(), "segmenting"):
        color = decode_color(read_bytes(picture), picture)
        _write(out / f"{name}.png", detection_masks(segmenter.segment(color), boxes, _size(color)))


def _scan(scan: _Unmasked, out: Path, segmenter: Segmenter, up: Float[np.ndarray, "3"]) -> None:
    """Masks of single images first, then one id for one object in all."""
    categories: dict[str, Mapping[int, str]] = {}
    for name in track(scan.names, "segmenting"):
        image = scan.color(name)
        segments = segmenter.segment(image)
        categories[name] = {i: segment.category for i, segment in enumerate(segments, 1)}
        _write(out / f"{name}.png", instance_masks(segments, _size(image)))
    frames = scan.frames({name: out / f"{name}.png" for name in scan.names})
    linked = link(frames, [categories[name] for name in frames.names])
    if not linked.categories:
        raise SegmentationError(
            f"{scan.folder}: no chair, table or car was found in two of its {len(frames)} frames"
        )
    for i, name in enumerate(frames.names):
        path = out / f"{name}.png"
        local = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        _write(path, linked.relabelled(i, np.asarray(local)))
    instances = {str(number): category for number, category in linked.categories.items()}
    document = json.dumps({"up_world": up.tolist(), "instances": instances, "by": _BY}, indent=1) + "\n"
    write_file(scan.folder / "instances.json", document.encode(), DatasetError)


def _up(command: SegmentCommand, scan: _Unmasked) -> Float[np.ndarray, "3"]:
    """What was typed, else what the file says, else what is known; a file of the user's own with more is not replaced."""
    path = scan.folder / "instances.json"
    content = read_json(path) if path.is_file() else {}
    if not isinstance(content, dict) or (
        content.get("by") != _BY and any(content[k] for k in content if k != "up_world")
    ):
        raise DatasetError(
            f"{path}: would be replaced, and holds more than up_world: move it away, and give --up"
        )
    up = command.up or content.get("up_world", scan.up_world)
    if up is None:
        raise DatasetError(f"{scan.folder}: say which way is up in the poses' world, as in --up 0 0 1")
    try:
        return direction(up, "--up" if command.up else f"{path}: up_world")
    except ValueError as error:
        raise DatasetError(str(error)) from error


def _size(color: np.ndarray) -> tuple[int, int]:
    return color.shape[0], color.shape[1]


def _write(path: Path, ids: np.ndarray) -> None:
    _, png = cv2.imencode(".png", ids.astype(np.uint16))
    path.write_bytes(png.tobytes())
