"""The project's own synthetic scan, generated where it is asked for; its layout is ScanNet's."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from objgraph.datasets import scannet
from objgraph.datasets.ground_truth import AnnotatedScan


def load(
    root: Path, scene: str | None = None, *, frames: int | None = None, laps: float | None = None
) -> AnnotatedScan:
    """The sample scan; generated under `root` at the first call, which takes some seconds.

    `frames` are those of the whole walk, `laps` how often it goes about the room; by default a walk past it.
    """
    return scannet.load(_folder(root, frames, laps) / "scannet", scene)


def scenes(root: Path) -> list[str]:
    return scannet.scenes(_folder(root) / "scannet")


def _folder(root: Path, frames: int | None = None, laps: float | None = None) -> Path:
    # renders, with open3d: slow to import
    from objgraph.synthetic.sample import CameraConfig, SampleConfig, ensure_sample

    camera = CameraConfig()
    if frames is not None:
        camera = replace(camera, frames=frames)
    if laps is not None:
        camera = replace(camera, sweep_rad=2 * np.pi * laps)
    return ensure_sample(root, SampleConfig(camera=camera))
