"""What the command line does to know what depth and poses are worth: `objgraph sensor`."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from objgraph.atomic import check_place, write_file
from objgraph.cli.map import load_scan_of
from objgraph.cli.progress import progress
from objgraph.cli.run_config import LIDAR_DATASETS, Source, Topics
from objgraph.errors import DatasetError
from objgraph.sensor import Sensor, SensorConfig, measure_sensor

_DEPTHS = (1.0, 2.0, 3.0)


@dataclass(frozen=True)
class SensorCommand:
    """Measure a scan's depth noise by range and how accurate its camera poses are, on walls and whatever else two frames both see."""

    out: Path
    """JSON file for the settings, which `objgraph map --config` takes."""
    dataset: str = "folder"
    """Data set, named as `objgraph map` does; no LiDAR's."""
    root: Path | None = None
    """The data set's folder."""
    scene: str | None = None
    """Name of the scan; may be left out where there is only one."""
    trajectory: Path | None = None
    """Trajectory file in the TUM format in place of the data set's own; for folder, tum and bag."""
    topic: Topics = field(default_factory=Topics)
    """Of a bag, in place of guesses."""
    look: Annotated[SensorConfig, tyro.conf.arg(name="")] = field(default_factory=SensorConfig)


def run_sensor(command: SensorCommand, console: Console) -> Sensor:
    """Measure, show, and write.

    Raises:
        DatasetError: the scan cannot be read, too little of it is seen twice, or the file cannot be written.
    """
    if command.dataset in LIDAR_DATASETS:
        raise DatasetError(
            f"data set '{command.dataset}' is a LiDAR's: `objgraph sensor` looks at depth images"
        )
    check_place(command.out, DatasetError)
    source = Source(
        command.dataset, command.root, command.scene, trajectory=command.trajectory, topic=command.topic
    )
    scan, _ = load_scan_of(source)
    with progress(console, transient=True) as tell:
        sensor = measure_sensor(scan.frames, command.look, tell)
    console.print(_table(sensor))
    document = {"settings": sensor.settings()}
    write_file(command.out, (json.dumps(document, indent=1) + "\n").encode(), DatasetError)
    console.print(f"written to {command.out}: `objgraph map --config {command.out}` takes it", markup=False)
    return sensor


def _table(sensor: Sensor) -> Table:
    table = Table(title=f"from {sensor.pairs} pairs of frames, {sensor.patches} planes that both see")
    for heading in ("what", "standard deviation"):
        table.add_column(heading)
    for depth in _DEPTHS:
        noise = float(sensor.noise(np.array([depth]))[0])
        table.add_row(f"a patch of surface at {depth:g} m", f"{1000 * noise:.1f} mm")
    rotation, translation = sensor.pose_sigma
    table.add_row("a camera's rotation, about each axis", f"{rotation * 57.29578:.2f} degrees")
    table.add_row("a camera's position, along each axis", f"{100 * translation:.1f} cm")
    return table
