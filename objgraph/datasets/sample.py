"""The project's own synthetic scan, generated where it is asked for; its layout is ScanNet's."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from objgraph.datasets import scannet
from objgraph.datasets.ground_truth import AnnotatedScan
from objgraph.synthetic.camera import CameraConfig
from objgraph.synthetic.sample import SampleConfig, ensure_sample


def load(
    root: Path, scene: str | None = None, *, frames: int | None = None, laps: float | None = None
) -> AnnotatedScan:
    """The sample scan; generated under `root` at the first call, which takes some seconds.

    `frames` are those of the whole walk, `laps` how often it goes about the room; by default a walk past it.
    """
    camera = CameraConfig()
    if frames is not None:
        camera = replace(camera, frames=frames)
    if laps is not None:
        camera = replace(camera, sweep_rad=2 * np.pi * laps)
    return scannet.load(ensure_sample(root, SampleConfig(camera=camera)) / "scannet", scene)


def scenes(root: Path) -> list[str]:
    return scannet.scenes(ensure_sample(root) / "scannet")
