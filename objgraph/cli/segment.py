"""What the command line does with colour images: `objgraph segment` writes the masks that are missing."""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.progress import track

from objgraph.atomic_folder import write_folder
from objgraph.datasets.files import decode_color, pick_folder, read_bytes
from objgraph.datasets.folder import color_path, frames_with_masks
from objgraph.datasets.folder_files import read_instances
from objgraph.datasets.kitti import CATEGORIES, frames
from objgraph.datasets.kitti_files import read_boxes
from objgraph.errors import DatasetError, SegmentationError
from objgraph.segment.link import link
from objgraph.segment.mask2former import Segmenter
from objgraph.segment.masks import detection_masks, instance_masks


@dataclass(frozen=True)
class SegmentCommand:
    """Segment the colour images of a data set that has no masks yet."""

    root: Path
    """The data set's folder; `masks` is written into it."""
    weights: str = "facebook/mask2former-swin-small-coco-instance"
    """Folder of a Mask2Former checkpoint, or its name in the local cache."""
    dataset: Literal["folder", "kitti"] = "folder"
    up: tuple[float, float, float] | None = None
    """Of a folder: the direction against gravity in the poses' world; by default what `instances.json` says."""
    device: str = "cpu"


def run_segment(command: SegmentCommand, console: Console) -> Path:
    """Write `masks`, and of a folder `instances.json`; both appear whole or not at all.

    Raises:
        SegmentationError: transformers or the weights are missing, or nothing was found.
        DatasetError: images are missing or damaged, or there are masks already.
    """
    masks = command.root / "masks"
    if masks.exists():
        raise DatasetError(f"{masks}: already there; remove it to segment the images again")
    segmenter = Segmenter.load(command.weights, device=command.device)
    if command.dataset == "kitti":
        write_folder(masks, lambda folder: _kitti(command.root, folder, segmenter))
    else:
        root = pick_folder(command.root, "depth", None)
        up = _up(command, root)
        write_folder(masks, lambda folder: _folder(root, folder, segmenter, up))
    console.print(f"written to {masks}")
    return masks


def _kitti(root: Path, out: Path, segmenter: Segmenter) -> None:
    """Each detection gets the mask that fills its image box best."""
    for name in track(frames(root), "segmenting"):
        path = root / "training" / "image_2" / f"{name}.png"
        color = decode_color(read_bytes(path), path)
        boxes = {
            i: (CATEGORIES[box.type], box.image_box)
            for i, box in enumerate(read_boxes(root / "detections" / f"{name}.txt"), 1)
            if box.type in CATEGORIES
        }
        _write(out / f"{name}.png", detection_masks(segmenter.segment(color), boxes, _size(color)))


def _folder(root: Path, out: Path, segmenter: Segmenter, up: Float[np.ndarray, "3"]) -> None:
    """Masks of single images first, then one id for one object in all."""
    categories: dict[str, Mapping[int, str]] = {}
    for name, color in track(list(_images(root)), "segmenting"):
        image = decode_color(read_bytes(color), color)
        segments = segmenter.segment(image)
        categories[name] = {i: segment.category for i, segment in enumerate(segments, 1)}
        _write(out / f"{name}.png", instance_masks(segments, _size(image)))
    scan = frames_with_masks(root, out)
    linked = link(scan, [categories[name] for name in scan.names])
    if not linked.categories:
        raise SegmentationError(f"{root}: no chair, table or car was found in two of its {len(scan)} frames")
    numbers = {name: i for i, name in enumerate(scan.names)}
    for name in categories:
        path = out / f"{name}.png"
        if name in numbers:
            local = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            _write(path, linked.relabelled(numbers[name], np.asarray(local)))
        else:
            path.unlink()
    instances = {str(number): category for number, category in linked.categories.items()}
    part = root / "instances.json.part"
    part.write_text(json.dumps({"up_world": up.tolist(), "instances": instances}, indent=1) + "\n")
    os.replace(part, root / "instances.json")


def _images(root: Path) -> Iterator[tuple[str, Path]]:
    """Frames with depth that have a colour image."""
    found = False
    for depth in sorted((root / "depth").glob("*.png"), key=lambda path: (len(path.stem), path.stem)):
        color = color_path(root, depth.stem)
        if color is not None:
            found = True
            yield depth.stem, color
    if not found:
        raise DatasetError(
            f"{root / 'color'}: holds no NAME.jpg or .png of a depth image's NAME: nothing to segment"
        )


def _up(command: SegmentCommand, root: Path) -> Float[np.ndarray, "3"]:
    if command.up is None:
        path = root / "instances.json"
        if not path.is_file():
            raise DatasetError(f"{root}: say which way is up in the poses' world, as in --up 0 0 1")
        return read_instances(path)[0]
    up = np.array(command.up)
    if not np.isfinite(up).all() or not up.any():
        raise DatasetError(f"--up {' '.join(map(str, command.up))} is no direction")
    return up / np.linalg.norm(up)


def _size(color: np.ndarray) -> tuple[int, int]:
    return color.shape[0], color.shape[1]


def _write(path: Path, ids: np.ndarray) -> None:
    _, png = cv2.imencode(".png", ids.astype(np.uint16))
    path.write_bytes(png.tobytes())
