"""What the command line does: `objgraph report`."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from objgraph.cli.map import load_frame_of, load_scan_of, report_scan
from objgraph.cli.run_config import CONFIG, LIDAR_DATASETS, Source, read_run
from objgraph.errors import ConfigError, DatasetError
from objgraph.maps.object_map import ObjectMap
from objgraph.show.report import REPORT, write_report

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReportCommand:
    """Write the page of a saved map: one HTML file to look at in a browser, which needs no network.

    The scan's points and frames come from where the map's `config.json` says; where they are not there any more, the
    page has the map alone.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the map."""


def run_report(command: ReportCommand, console: Console) -> Path:
    """Load the map and, where it can be read, its scan; raises MapError."""
    object_map = ObjectMap.load(command.folder)
    try:
        _over_the_scan(object_map, read_run(command.folder / CONFIG, {}, {}).source, command.folder)
    except (ConfigError, DatasetError) as error:
        log.warning("the page has no points and no views: %s", error)
        write_report(command.folder)
    path = command.folder / REPORT
    console.print(f"{path}: {path.stat().st_size / 1e6:.1f} MB", markup=False, soft_wrap=True)
    return path


def _over_the_scan(object_map: ObjectMap, source: Source, folder: Path) -> None:
    if source.dataset in LIDAR_DATASETS:
        write_report(folder, load_frame_of(source).p_world)
    else:
        report_scan(object_map, load_scan_of(source)[0], folder)
