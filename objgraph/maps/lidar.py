"""One scan and its detections in, a map of its objects out."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from factors import checks
from objgraph.errors import ConfigError, ObjectGraphError, ObservationError, SolveError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.builder import GraphConfig
from objgraph.graph.solve import SolverConfig
from objgraph.maps.entry import map_entry
from objgraph.maps.lidar_task import ROADS, LidarTaskConfig, task_of
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Instance
from objgraph.observation.lidar.frame import Detection, LidarFrame
from objgraph.priors.mesh import RESOLUTIONS
from objgraph.priors.registry import prior_for
from objgraph.priors.store import load_prior_file

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LidarMappingConfig:
    """All settings of mapping a scan."""

    seed: int = 0
    """Of everything that is sampled."""
    mesh_resolution: int = 64
    """Cells along an edge of the canonical cube."""
    priors: tuple[str, ...] = ()
    """Your own priors, .safetensors files: each serves its category in place of the shipped one."""
    task: LidarTaskConfig = field(default_factory=LidarTaskConfig)
    graph: GraphConfig = ROADS
    solver: SolverConfig = field(default_factory=SolverConfig)
    heading_modes: HeadingModesConfig | None = field(default_factory=HeadingModesConfig)
    """The search for other headings, where no detector said how the object stands."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(self, ConfigError, mesh_resolution=RESOLUTIONS)


def map_lidar(
    frame: LidarFrame,
    config: LidarMappingConfig | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ObjectMap:
    """Estimate every detected object; all decode together, and one that fails says why and stops no other.

    Raises:
        ObservationError: `frame` is no scan.
        PriorError: one of the files of `config.priors` is no prior.
    """
    config = checks.settings_or_default(config, LidarMappingConfig, ConfigError)
    checks.instance("frame", frame, LidarFrame, ObservationError)
    tell = progress or (lambda what, done, total: None)
    given = [load_prior_file(Path(path)) for path in config.priors]
    find_prior = partial(prior_for, given=given)
    begun = time.perf_counter()
    tasks: dict[int, EstimationTask] = {}
    entries: dict[int, MappedObject] = {}
    for detection in frame.detections:
        try:
            prior = find_prior(detection.category)
            tasks[detection.id] = task_of(frame, detection, prior, config.task, config.seed)
        except ObjectGraphError as error:
            entries[detection.id] = _failed(detection, error)
    estimator = GraphEstimator(config.graph, config.solver, config.heading_modes)
    results = estimator.estimate(list(tasks.values()), lambda done, total: tell("solving", done, total))
    for done, ((number, task), result) in enumerate(zip(tasks.items(), results, strict=True), 1):
        entries[number] = _entry(frame.detection(number), task, result, config)
        tell(f"{entries[number].status} {entries[number].category} {number}", done, len(tasks))
    share = (time.perf_counter() - begun) / max(len(tasks), 1)  # they are solved together
    objects = tuple(
        replace(entries[each.id], seconds=share) if entries[each.id].status == "mapped" else entries[each.id]
        for each in frame.detections
    )
    return ObjectMap(frame.name, objects, frame.up_world)


def _entry(
    detection: Detection, task: EstimationTask, result: Estimate | SolveError, config: LidarMappingConfig
) -> MappedObject:
    try:
        if isinstance(result, SolveError):
            raise result
        instance = Instance(detection.id, detection.category)
        entry = map_entry(instance, task.prior, result, task.views, config.mesh_resolution)
        return replace(entry, estimator="graph")
    except ObjectGraphError as error:
        return _failed(detection, error)


def _failed(detection: Detection, error: ObjectGraphError) -> MappedObject:
    log.warning("%s could not be mapped: %s", detection.name, error)
    return MappedObject(detection.id, detection.category, "failed", str(error))
