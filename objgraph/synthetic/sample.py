"""The project's own sample data: a synthetic room in ScanNet's layout, with its ground truth beside it."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from objgraph.atomic import ensure_folder, write_folder
from objgraph.synthetic.camera import CameraConfig, camera_matrix, camera_path
from objgraph.synthetic.files import write_frame, write_ground_truth, write_scan_description
from objgraph.synthetic.render import Renderer
from objgraph.synthetic.scene import RoomConfig, furnish, room_shell
from objgraph.synthetic.sensor import SensorConfig, sense_depth, sense_masks

_RECORD = "sample.json"
_VERSION = 1  # raised when the same configuration begins to give other files


@dataclass(frozen=True)
class SampleConfig:
    """A synthetic scan; equal configurations give equal files."""

    seed: int = 12
    """Of furniture, layout, path and noise."""
    name: str = "scene9000_00"
    """Name of the scan."""
    room: RoomConfig = field(default_factory=RoomConfig)
    """What stands in the room."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    """The path and the camera."""
    sensor: SensorConfig = field(default_factory=SensorConfig)
    """The faults of depth and masks."""


_DEFAULT = SampleConfig()


def generate_sample(root: Path, config: SampleConfig = _DEFAULT) -> Path:
    """Write a sample data set to the folder `root`, which must not exist or be empty, and return `root`.

    `root` then holds `scannet/scans/NAME`, `scan2cad/full_annotations.json` and `shapenet/ShapeNetCore.v2`. It
    appears complete or not at all. Raises `DatasetError` when `root` is in use or the room too small.
    """
    return write_folder(root, lambda folder: _write_sample(folder, config))


def ensure_sample(cache: Path, config: SampleConfig = _DEFAULT) -> Path:
    """The root of the sample under `cache`, generated when it is not there yet.

    The folder's name holds a digest of the configuration, so that no other sample is taken for it.
    """
    root = cache / f"sample-{_digest(config)}"
    return ensure_folder(root, _RECORD, lambda folder: _write_sample(folder, config))


def _write_sample(root: Path, config: SampleConfig) -> None:
    furniture_rng, path_rng, color_rng, sensor_rng = np.random.default_rng(config.seed).spawn(4)
    camera, frames = config.camera, config.camera.frames
    scan = root / "scannet" / "scans" / config.name
    scan.mkdir(parents=True)

    pieces = furnish(config.room, furniture_rng)
    renderer = Renderer(pieces, room_shell(config.room), color_rng)
    targets = np.stack([piece.T_world_object[:3, 3] for piece in pieces])
    matrix = camera_matrix(camera)
    for index, T_world_camera in enumerate(camera_path(camera, targets, path_rng)):
        view = renderer.render(matrix, T_world_camera, camera.width, camera.height)
        depth = sense_depth(view.depth, view.incidence, config.sensor, sensor_rng)
        instances = sense_masks(view.instances, config.sensor, sensor_rng)
        write_frame(scan, index, view.color, depth, instances, T_world_camera)

    write_scan_description(scan, pieces, matrix, (camera.width, camera.height), frames)
    write_ground_truth(root, config.name, pieces)
    record = {"version": _VERSION, "config": dataclasses.asdict(config)}
    (root / _RECORD).write_text(json.dumps(record, indent=1) + "\n")


def _digest(config: SampleConfig) -> str:
    record = json.dumps([_VERSION, dataclasses.asdict(config)], sort_keys=True)
    return hashlib.sha256(record.encode()).hexdigest()[:12]
