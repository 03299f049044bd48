"""One scan and its detections in, a map of its objects out."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from factors import checks
from objgraph.errors import ConfigError, ObjectGraphError, ObservationError, ProcessError, SolveError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import GraphConfig
from objgraph.graph.solve import SolverConfig
from objgraph.maps.entry import failed_entry, map_entry
from objgraph.maps.lidar_task import ROADS, LidarTaskConfig, task_of
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.frames import Instance
from objgraph.observation.lidar.frame import Detection, LidarFrame
from objgraph.priors.mesh import RESOLUTION, RESOLUTIONS
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import load_prior_file
from objgraph.work import Engine, Workers, prepare, spread


@dataclass(frozen=True)
class LidarMappingConfig:
    """All settings of mapping a scan."""

    seed: int = 0
    """Of everything that is sampled."""
    mesh_resolution: int = RESOLUTION
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
    jobs: int = 1,
    engine: Engine = "local",
) -> ObjectMap:
    """Estimate every detected object, `jobs` at the same time as `map_scan` does; one that fails says why and stops no
    other.

    Raises:
        ObservationError: `frame` is no scan.
        PriorError: one of the files of `config.priors` is no prior.
        ConfigError: `jobs` is not positive.
        ProcessError: there is no Ray cluster.
    """
    config = checks.settings_or_default(config, LidarMappingConfig, ConfigError)
    checks.instance("frame", frame, LidarFrame, ObservationError)
    jobs = checks.whole("jobs", jobs, checks.Range(1), ConfigError)
    tell = progress or (lambda what, done, total: None)
    if jobs > 1 and engine == "local":
        prepare(__name__)
    given = [load_prior_file(Path(path)) for path in config.priors]
    find_prior = partial(prior_for, given=given)
    count, entries = len(frame.detections), {}
    works = (_work(frame, detection, config, find_prior) for detection in frame.detections)
    for place, entry in spread(works, Workers(min(jobs, max(count, 1)), engine)):
        instance = _instance(frame.detections[place])
        entry = failed_entry(instance, entry) if isinstance(entry, ProcessError) else entry
        entries[place] = entry
        tell(f"{entry.status} {instance.category} {instance.id}", len(entries), count)
    return ObjectMap(frame.name, tuple(entries[place] for place in range(count)), frame.up_world)


def _work(
    frame: LidarFrame,
    detection: Detection,
    config: LidarMappingConfig,
    find_prior: Callable[[str], ShapePrior],
) -> Callable[[], MappedObject]:
    """What is left to be done for an object once its points are found; a failure is in the result, not raised."""
    try:
        task = task_of(frame, detection, find_prior(detection.category), config.task, config.seed)
    except ObjectGraphError as error:
        return partial(failed_entry, _instance(detection), error)
    return partial(_mapped, _instance(detection), task, config)


def _mapped(instance: Instance, task: EstimationTask, config: LidarMappingConfig) -> MappedObject:
    begun = time.perf_counter()
    try:
        (result,) = GraphEstimator(config.graph, config.solver, config.heading_modes).estimate([task])
        if isinstance(result, SolveError):
            raise result
        entry = map_entry(instance, task.prior, result, task.views, config.mesh_resolution)
    except ObjectGraphError as error:
        return failed_entry(instance, error)
    return replace(entry, estimator="graph", seconds=time.perf_counter() - begun)


def _instance(detection: Detection) -> Instance:
    return Instance(detection.id, detection.category)
