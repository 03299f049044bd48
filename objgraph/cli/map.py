"""What the command line does: `objgraph map` and its helpers."""

import json
import logging
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from objgraph.bench.comparison.boxes.evaluate import KITTI
from objgraph.bench.metrics.maps import evaluated
from objgraph.bench.metrics.tables import evaluation_table
from objgraph.cli.progress import telling
from objgraph.datasets.kitti import frames, load_frame
from objgraph.datasets.registry import load_scan
from objgraph.errors import DatasetError
from objgraph.graph.builder import GraphConfig
from objgraph.maps.lidar import LidarMappingConfig, map_lidar
from objgraph.maps.lidar_task import ROADS, LidarTaskConfig
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.pipeline import MappingConfig, map_scan, scene_points
from objgraph.observation.frames import Scan
from objgraph.show.map_picture import map_picture
from objgraph.show.street_picture import street_picture
from objgraph.show.tables import map_table
from objgraph.synthetic.street import ensure_street

log = logging.getLogger(__name__)

STREET = "street"
SAMPLE_ROOT = Path("out/sample")
"""Where the sample scan is generated unless `--root` says otherwise."""


@dataclass(frozen=True)
class MapCommand:
    """Map the objects of one scan."""

    dataset: str
    """Data set: folder, sample, scannet, sevenscenes or tum; or kitti or street (the project's own), scans of a LiDAR."""
    out: Path
    """Folder for the map, its meshes and its picture."""
    root: Path | None = None
    """The data set's folder; the sample needs none."""
    scene: str | None = None
    """Name of the scan (of kitti the frame); may be left out where there is only one."""
    categories: tuple[str, ...] = ()
    """Map objects of these categories alone; by default all."""
    trajectory: Path | None = None
    """Trajectory file in the TUM format in place of the data set's own; for folder and tum."""
    scan2cad: Path | None = None
    """Folder of the Scan2CAD annotations; by default beside `root`. Read by the evaluation alone."""
    shapenet: Path | None = None
    """Folder of the ShapeNet meshes; by default beside `root`. Read by the evaluation alone."""
    config: Annotated[MappingConfig, tyro.conf.arg(name="")] = field(default_factory=MappingConfig)
    """How it is mapped."""
    lidar: LidarTaskConfig = field(default_factory=LidarTaskConfig)
    """Of kitti and street: views, the road and the detector's errors."""
    lidar_graph: GraphConfig = ROADS
    """Of kitti and street: how measurements and priors are weighed there."""


def run_map(command: MapCommand, console: Console) -> ObjectMap:
    """Load, map, evaluate where there is ground truth, save, and show."""
    if command.dataset in (KITTI, STREET):
        return _map_lidar(command, console)
    scan = _limited(_load(command), command.categories)
    config = command.config
    with telling(console) as tell:
        object_map = map_scan(scan, config, tell)
    object_map.save(command.out)
    try:
        object_map = evaluated(object_map, dict(scan.ground_truth))
        object_map.save(command.out)
    except DatasetError as error:
        log.warning("the map is saved but not evaluated: %s", error)
    _write_config(command.out / "config.json", config)
    _show(object_map, scan, command.out, console)
    return object_map


def _map_lidar(command: MapCommand, console: Console) -> ObjectMap:
    """One scan of a LiDAR; views, initialisation and the paper's estimator have no say there."""
    root, config = command.root, command.config
    if command.dataset == STREET:
        root = ensure_street(SAMPLE_ROOT if root is None else root)
    elif root is None:
        raise DatasetError(f"data set '{command.dataset}': --root must name its folder")
    if config.estimator != "graph":
        raise DatasetError(
            f"data set '{command.dataset}' is mapped by the graph alone; see objgraph evaluate for the others"
        )
    for name in ("views", "view", "sampling", "initialisation", "graph"):
        if getattr(config, name) != getattr(MappingConfig(), name):
            raise DatasetError(
                f"data set '{command.dataset}' does not use --{name}: see --lidar and --lidar-graph"
            )
    frame = load_frame(root, command.scene or (frames(root)[0] if command.dataset == STREET else None))
    if command.categories:
        kept = tuple(each for each in frame.detections if each.category in command.categories)
        frame = replace(frame, detections=kept)
    if not frame.detections:
        raise DatasetError(f"frame {frame.name}: nothing is detected that could be mapped")
    settings = LidarMappingConfig(
        config.seed, config.mesh_resolution, config.priors, command.lidar, command.lidar_graph, config.solver
    )
    with telling(console) as tell:
        object_map = map_lidar(frame, settings, tell)
    object_map.save(command.out)
    _write_config(command.out / "config.json", settings)
    console.print(map_table(object_map))
    street_picture(object_map, frame, command.out / "map.png")
    console.print(f"written to {command.out}")
    return object_map


def _load(command: MapCommand) -> Scan:
    root = command.root
    if root is None:
        if command.dataset != "sample":
            raise DatasetError(f"data set '{command.dataset}': --root must name its folder")
        root = SAMPLE_ROOT
    options = {name: getattr(command, name) for name in ("trajectory", "scan2cad", "shapenet")}
    return load_scan(
        command.dataset, root, command.scene, **{k: v for k, v in options.items() if v is not None}
    )


def _limited(scan: Scan, categories: tuple[str, ...]) -> Scan:
    """The scan with the objects of some categories, or with all."""
    if not categories:
        return scan
    kept = tuple(instance for instance in scan.instances if instance.category in categories)
    if not kept:
        known = ", ".join(sorted({instance.category for instance in scan.instances})) or "none"
        raise DatasetError(f"{scan.name} has no object of {', '.join(categories)}; its categories: {known}")
    return replace(scan, instances=kept)


def _show(object_map: ObjectMap, scan: Scan, out: Path, console: Console) -> None:
    console.print(map_table(object_map))
    table = evaluation_table(object_map)
    if table is not None:
        console.print(table)
    if object_map.mapped:
        frames = np.unique(np.linspace(0, len(scan.frames) - 1, min(24, len(scan.frames))).astype(int))
        points, colors = scene_points(scan, frames, pixels=20000)
        map_picture(object_map, points, colors, out / "map.png")
    console.print(f"written to {out}")


def _write_config(path: Path, config: MappingConfig | LidarMappingConfig) -> None:
    path.write_text(json.dumps(asdict(config), indent=2) + "\n")
