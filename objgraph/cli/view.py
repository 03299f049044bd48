"""What the command line does: `objgraph view`."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from objgraph.cli.map import load_frame_of, load_scan_of, points_of
from objgraph.cli.progress import Progress, progress
from objgraph.cli.run_config import CONFIG, LIDAR_DATASETS, MapRun, Source, read_run
from objgraph.errors import ConfigError, DatasetError, ViewError
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_scan
from objgraph.priors.registry import prior_for
from objgraph.priors.store import load_prior_file

if TYPE_CHECKING:
    from rerun import RecordingStream

log = logging.getLogger(__name__)

RECORDING = "map.rrd"
"""Where a recording goes, in the map's folder, if there is no screen and no other name."""


@dataclass(frozen=True)
class ViewCommand:
    """Show a saved map in the viewer rerun: meshes, boxes and ellipsoids over the scan, and its frames with masks and outlines.

    The scan comes from where the map's `config.json` says; where it is not there any more, the map alone is shown.
    Without a screen, or with `--save`, the recording goes into a file.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the map."""
    save: Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd")] = None
    """Write this file in place of opening a window."""
    frames: int = 60
    """Frames of the scan that are shown, evenly taken, beside those that objects were mapped from."""
    solve: Annotated[int | None, tyro.conf.arg(metavar="ID")] = None
    """Solve this object again and show the solver's steps on the timeline `iteration`."""


def run_view(command: ViewCommand, console: Console) -> Path | None:
    """Load the map and, where it can be read, its scan; the file that was written, None for a window.

    Raises:
        MapError: there is no map, or it is damaged.
        ViewError: the viewer's package is missing, the file cannot be written, or the object cannot be solved again.
    """
    from objgraph.show import rerun_view  # the package is optional

    if command.frames < 1:
        raise ViewError(f"--frames {command.frames}: at least one")
    path = command.save or command.folder / RECORDING
    to_file = command.save is not None or not rerun_view.has_display()
    if to_file:
        rerun_view.check_recording(path)
    object_map = ObjectMap.load(command.folder)
    recording = rerun_view.new_recording(object_map.scene)
    rerun_view.log_objects(recording, object_map, command.folder)
    framed, solved = False, None
    with progress(console) as tell:
        if command.solve is not None:
            solved = _log_solve(recording, object_map, command, tell)
        try:
            source = read_run(command.folder / CONFIG, {}, {}).source
            framed = _log_scan(recording, object_map, source, command, tell)
        except (ConfigError, DatasetError) as error:
            log.warning("the map is shown without its scan: %s", error)
    recording.send_blueprint(rerun_view.map_layout(object_map, frames=framed, solved=solved))
    if not to_file:
        rerun_view.show_recording(recording)
        return None
    rerun_view.save_recording(recording, path)
    size = f"{path.stat().st_size / 1e6:.1f} MB"
    console.print(
        f"{path}: {size}; `rerun {path}` shows it, or https://app.rerun.io", markup=False, soft_wrap=True
    )
    return path


def _log_scan(
    recording: "RecordingStream", object_map: ObjectMap, source: Source, command: ViewCommand, tell: Progress
) -> bool:
    """Its points and, of cameras, the frames, which nobody looks at beside the solver's steps; whether there are any."""
    from objgraph.show import rerun_view

    if source.dataset in LIDAR_DATASETS:
        rerun_view.log_points(recording, load_frame_of(source).p_world, None)
        return False
    scan, _ = load_scan_of(source)
    rerun_view.log_points(recording, *points_of(scan))
    if command.solve is not None:
        return False
    rerun_view.log_frames(recording, object_map, scan.frames, command.frames, tell)
    return True


def _log_solve(
    recording: "RecordingStream", object_map: ObjectMap, command: ViewCommand, tell: Progress
) -> int:
    """Map one object anew with the map's own settings, and log the steps; its id. Raises ViewError, DatasetError, ConfigError."""
    from objgraph.show import rerun_view

    run = read_run(command.folder / CONFIG, {}, {})
    settings = _settings_of(run)
    scan, _ = load_scan_of(run.source)
    known = [entry.id for entry in object_map.mapped]
    kept = tuple(each for each in scan.instances if each.id == command.solve and each.id in known)
    if not kept:
        raise ViewError(f"--solve {command.solve}: no mapped object has this id; there are {known}")
    iterates = rerun_view.Iterates()
    (entry,) = map_scan(replace(scan, instances=kept), settings, tell, watch=iterates).objects
    if entry.status != "mapped":
        raise ViewError(f"--solve {entry.id}: {entry.category} cannot be solved again: {entry.reason}")
    prior = prior_for(entry.category, given=[load_prior_file(Path(path)) for path in settings.priors])
    rerun_view.log_iterations(recording, prior, iterates.towards(entry.state))
    return entry.id


def _settings_of(run: MapRun) -> MappingConfig:
    settings = run.settings
    if not isinstance(settings, MappingConfig):
        raise ViewError("--solve shows objects that were mapped from depth images, not from a LiDAR's scan")
    if settings.estimator == "adam":
        raise ViewError("--solve shows the graph's steps; this map was estimated by --estimator adam")
    return settings
