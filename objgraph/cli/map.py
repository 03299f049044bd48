"""What the command line does: `objgraph map` and its helpers."""

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
import tyro
from jaxtyping import Float
from rich.console import Console

from objgraph.atomic import check_place
from objgraph.cli.progress import progress
from objgraph.cli.run_config import MapRun, Source, Topics, read_run, root_of
from objgraph.datasets.ground_truth import AnnotatedScan, annotated
from objgraph.datasets.registry import load_lidar_frame, load_scan, scenes
from objgraph.errors import DatasetError, EvaluationError, MapError
from objgraph.maps.files import DOCUMENT
from objgraph.maps.lidar import LidarMappingConfig, map_lidar
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_scan, scene_points
from objgraph.metrics.maps import MapErrors, evaluate_map
from objgraph.metrics.tables import evaluation_table
from objgraph.observation.frames import Scan
from objgraph.observation.lidar.frame import LidarFrame
from objgraph.priors.categories import category_of
from objgraph.show.map_picture import map_picture
from objgraph.show.report import REPORT, object_pictures, write_report
from objgraph.show.street_picture import street_picture
from objgraph.show.tables import map_table
from objgraph.work import Engine

log = logging.getLogger(__name__)

PICTURE = "map.png"
_MOST_JOBS = 4
"""Unless more are asked for: each takes memory."""
_DEFAULTS = MappingConfig()


def _option(metavar: str, default: object = None) -> Any:
    """How the help shows an option that stands for the settings' own value unless it is given."""
    return tyro.conf.arg(
        metavar=metavar, help_behavior_hint="" if default is None else f"(default: {default})"
    )


@dataclass(frozen=True)
class MapCommand:
    """Map the objects of one scan."""

    out: Path
    """Folder for the map, its meshes and its picture."""
    dataset: Annotated[str | None, _option("STR")] = None
    """Data set: folder, bag, bop, icl, nerfstudio, sample, scannet, sevenscenes or tum; or kitti, lidar or street (the project's own), scans of a LiDAR."""
    root: Annotated[Path | None, _option("PATH")] = None
    """The data set's folder; the sample and the street need none."""
    scene: Annotated[str | None, _option("STR")] = None
    """Name of the scan (of kitti or lidar the frame); may be left out where there is only one."""
    scenes: Annotated[str | None, _option("{all,FILE}")] = None
    """Map all scans of the data set, or those that a file names, one a line, each into its own folder of `out`; a run that
    was stopped goes on with those that have no page yet."""
    categories: Annotated[tuple[str, ...], _option("[STR [STR ...]]")] = ()
    """Map objects of these categories alone; by default all."""
    trajectory: Annotated[Path | None, _option("PATH")] = None
    """Trajectory file in the TUM format in place of the data set's own; for folder, tum and bag."""
    topic: Topics = field(default_factory=Topics)
    """Of a bag, in place of guesses."""
    scan2cad: Annotated[Path | None, _option("PATH")] = None
    """Folder of the Scan2CAD annotations; by default beside `root`. Read by the evaluation alone."""
    shapenet: Annotated[Path | None, _option("PATH")] = None
    """Folder of the ShapeNet meshes; by default beside `root`. Read by the evaluation alone."""
    config: Annotated[Path | None, _option("FILE")] = None
    """JSON file with these and all other settings, whole or in part, as the `config.json` of an earlier run; options win
    over it."""
    views: Annotated[int | None, _option("INT", _DEFAULTS.views)] = None
    """Views of each object."""
    seed: Annotated[int | None, _option("INT", _DEFAULTS.seed)] = None
    """Of everything that is sampled."""
    mesh_resolution: Annotated[int | None, _option("INT", _DEFAULTS.mesh_resolution)] = None
    """Cells along an edge of the canonical cube."""
    priors: Annotated[tuple[str, ...], _option("[FILE [FILE ...]]")] = ()
    """Your own priors, .safetensors files: each serves its category in place of the shipped one."""
    calibration: Annotated[str | None, _option("FILE")] = None
    """A file of `objgraph calibrate` that says how far objects are to be trusted; by default the shipped one does."""
    estimator: Annotated[
        Literal["graph", "adam", "both"] | None, _option("{graph,adam,both}", _DEFAULTS.estimator)
    ] = None
    """Who estimates: the factor graph, the paper's gradient descent, or both; of both, the map takes the graph's and keeps
    the other beside it."""
    min_pixels: Annotated[int | None, _option("INT", _DEFAULTS.sampling.min_pixels)] = None
    """Mask pixels with depth below which a view says too little to be used."""
    pose_sigma: Annotated[tuple[float, float] | None, _option("FLOAT FLOAT")] = None
    """Radians and metres by which each camera's pose may be wrong; by default poses are taken as exact."""
    jobs: Annotated[int | None, _option("INT", "the cores, at most 4")] = None
    """Objects, or with `scenes` scans, mapped at the same time, each in a process of its own; the map is the same."""
    engine: Annotated[Engine, _option("{local,ray}", "local")] = "local"
    """Whose processes: this machine's, or those of a Ray cluster (docs/guides/many-scenes.md)."""


_SOURCE = ("dataset", "root", "scene", "categories", "trajectory", "scan2cad", "shapenet", "topic")
_SETTINGS: dict[str, tuple[str, ...]] = {
    "views": ("views",),
    "seed": ("seed",),
    "mesh_resolution": ("mesh_resolution",),
    "priors": ("priors",),
    "calibration": ("calibration",),
    "estimator": ("estimator",),
    "min_pixels": ("sampling.min_pixels",),
    "pose_sigma": ("graph.pose_sigma",),
}
"""Where an option's value lies in the settings of a camera or of a LiDAR."""


def run_map(command: MapCommand, console: Console) -> ObjectMap:
    """Load, map, evaluate where there is ground truth, save, and show: a table, a picture and a page."""
    run = run_of(command)
    check_place(command.out / DOCUMENT, MapError)
    settings = run.settings
    if isinstance(settings, LidarMappingConfig):
        return _map_lidar(run.source, settings, command, console)
    scan, scene = load_scan_of(run.source)
    scan = _limited(scan, run.source.categories)
    with progress(console) as tell:
        object_map = map_scan(scan, settings, tell, jobs=jobs_of(command), engine=command.engine)
    _save(object_map, MapRun(replace(run.source, scene=scene), settings), command.out)
    errors = _evaluated(object_map, annotated(scan), command.out)
    _show(object_map, errors, scan, command.out, console)
    return object_map


class NothingToMapError(DatasetError):
    """A scan has no object, or none of the categories that are asked for."""


def jobs_of(command: MapCommand) -> int:
    """How many processes."""
    return min(torch.get_num_threads(), _MOST_JOBS) if command.jobs is None else command.jobs


def run_of(command: MapCommand) -> MapRun:
    """What was typed over what the file says; an empty list is none typed."""
    topics = {name: value for name, value in vars(command.topic).items() if value}
    given = {**vars(command), "topic": topics}
    typed = {name: value for name, value in given.items() if value not in (None, (), {})}
    options = {
        f"--{name.replace('_', '-')}": (paths, typed[name])
        for name, paths in _SETTINGS.items()
        if name in typed
    }
    return read_run(command.config, {name: typed[name] for name in _SOURCE if name in typed}, options)


def _map_lidar(
    source: Source, settings: LidarMappingConfig, command: MapCommand, console: Console
) -> ObjectMap:
    """One scan of a LiDAR."""
    frame, out = load_frame_of(source), command.out
    with progress(console) as tell:
        object_map = map_lidar(frame, settings, tell, jobs_of(command), command.engine)
    _save(object_map, MapRun(replace(source, scene=source.scene or frame.name), settings), out)
    console.print(map_table(object_map))
    street_picture(object_map, frame, out / PICTURE)
    write_report(out, frame.p_world)
    console.print(_written(out), markup=False)
    return object_map


def _written(out: Path) -> str:
    return f"written to {out}; {out / REPORT} shows it"


def load_frame_of(source: Source) -> LidarFrame:
    """The LiDAR's scan; raises DatasetError."""
    for name in ("trajectory", "scan2cad", "shapenet"):
        if getattr(source, name) is not None:
            raise DatasetError(f"data set '{source.dataset}' does not use --{name}")
    if source.topic.options():
        raise DatasetError(f"data set '{source.dataset}' does not use --topic")
    frame = load_lidar_frame(source.dataset, root_of(source), source.scene)
    if source.categories:
        wanted = {category_of(each) for each in source.categories}
        kept = tuple(each for each in frame.detections if category_of(each.category) in wanted)
        others = tuple(each for each in frame.detections if category_of(each.category) not in wanted)
        frame = replace(frame, detections=kept, others=(*frame.others, *others))
    if not frame.detections:
        raise NothingToMapError(f"frame {frame.name}: nothing is detected that could be mapped")
    return frame


def load_scan_of(source: Source) -> tuple[Scan, str | None]:
    """The scan, and its name where one was given or the data set has but one; raises DatasetError."""
    root = root_of(source)
    options = {name: getattr(source, name) for name in ("trajectory", "scan2cad", "shapenet")}
    given = {name: value for name, value in options.items() if value is not None}
    scan = load_scan(source.dataset, root, source.scene, **given, **source.topic.options())
    names = scenes(source.dataset, root) if source.scene is None else [source.scene]
    return scan, names[0] if len(names) == 1 else None


def _limited(scan: Scan, categories: tuple[str, ...]) -> Scan:
    """The scan with the objects of some categories, or with all."""
    if not categories:
        return scan
    wanted = {category_of(each) for each in categories}
    kept = tuple(instance for instance in scan.instances if category_of(instance.category) in wanted)
    if not kept:
        known = ", ".join(sorted({instance.category for instance in scan.instances})) or "none"
        raise NothingToMapError(
            f"{scan.name} has no object of {', '.join(categories)}; its categories: {known}"
        )
    return replace(scan, instances=kept)


def _save(object_map: ObjectMap, run: MapRun, out: Path) -> None:
    """The map and its settings; an earlier map's picture and page say nothing of this one."""
    try:
        for name in (PICTURE, REPORT):
            (out / name).unlink(missing_ok=True)
        object_map.save(out)
        run.save(out)
    except OSError as error:
        raise MapError(f"{out}: the map cannot be written here ({error})") from error


def _evaluated(object_map: ObjectMap, scan: AnnotatedScan, out: Path) -> MapErrors | None:
    """The map's errors, written beside it; None where there is no ground truth or it cannot be read."""
    try:
        errors = evaluate_map(object_map, dict(scan.ground_truth))
        if errors.objects:
            errors.save(out)
            return errors
    except (DatasetError, EvaluationError) as error:
        log.warning("the map is saved but not evaluated: %s", error)
    return None


def _show(object_map: ObjectMap, errors: MapErrors | None, scan: Scan, out: Path, console: Console) -> None:
    console.print(map_table(object_map))
    judged = [entry.trust for entry in object_map.mapped if entry.trust is not None]
    if 2 * sum(trust.is_poor for trust in judged) > max(len(judged), 2):
        console.print(
            "most objects are poor: `objgraph doctor` with the same --dataset, --root, --scene, --trajectory and --topic "
            "checks poses, depth, masks and gravity"
        )
    table = None if errors is None else evaluation_table(object_map, errors)
    if table is not None:
        console.print(table)
    points, colors = points_of(scan)
    if object_map.mapped:
        map_picture(object_map, points, colors, out / PICTURE)
    write_report(out, points, colors, object_pictures(object_map.mapped, scan.frames))
    console.print(_written(out), markup=False)


def points_of(scan: Scan) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"] | None]:
    """What a picture of the scan is drawn from: world points of some frames, and their colours."""
    frames = np.unique(np.linspace(0, len(scan.frames) - 1, min(24, len(scan.frames))).astype(int))
    return scene_points(scan, frames, pixels=20000)


def report_scan(object_map: ObjectMap, scan: Scan, out: Path) -> None:
    """The page of a saved map, over its scan."""
    points, colors = points_of(scan)
    write_report(out, points, colors, object_pictures(object_map.mapped, scan.frames))
