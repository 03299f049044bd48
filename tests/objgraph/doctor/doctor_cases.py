"""A healthy folder and ways to break it."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from objgraph.datasets import scannet
from objgraph.datasets.trajectory import read_labelled_poses
from objgraph.doctor import Examined, Finding, examine_scan
from objgraph.observation.frames import Frame, FrameSource, Scan
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, generate_sample
from tests.objgraph.datasets.dataset_folders import tum_words, write_plain_folder

FRAMES = 8
SAMPLE = SampleConfig(camera=CameraConfig(frames=FRAMES, width=160, height=120))


def write_healthy_folder(folder: Path) -> Path:
    """The project's sample room in the plain layout, rendered small."""
    scan = scannet.load(generate_sample(folder / "sample", SAMPLE) / "scannet")
    return write_plain_folder(folder / "room", scan)


def examined(folder: Path) -> Examined:
    return examine_scan("folder", folder)


def findings(folder: Path) -> list[Finding]:
    """What is wrong, without the notes."""
    return [finding for section in examined(folder).sections for finding in section.wrong]


def edit(path: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def change_images(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in folder.glob("*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(path), change(image))


def change_poses(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """`change` is given all poses (n, 4, 4) in the frames' order."""
    path = folder / "poses.txt"
    poses = read_labelled_poses(path)
    changed = change(np.stack(list(poses.values())))
    lines = [f"{name} {tum_words(T)}\n" for name, T in zip(poses, changed, strict=True)]
    path.write_text("".join(lines))


class Moved(FrameSource):
    """A scan's frames with other poses."""

    def __init__(self, frames: list[Frame], change: Callable[[np.ndarray], np.ndarray]) -> None:
        self._frames, self._change = frames, change

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        frame = self._frames[index]
        return replace(frame, T_world_camera=self._change(frame.T_world_camera))


def moved(scan: Scan, frames: list[Frame], change: Callable[[np.ndarray], np.ndarray]) -> Scan:
    return replace(scan, frames=Moved(frames, change))
