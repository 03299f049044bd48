"""The main job: a scan goes in, a map of solved objects with covariances comes out."""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from factors import checks
from objgraph.errors import (
    ConfigError,
    InitialisationError,
    ObjectGraphError,
    ObservationError,
    ProcessError,
    SolveError,
)
from objgraph.estimate import AdamConfig, AdamEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.estimate.task import Estimate, EstimationTask, Estimator
from objgraph.geometry.frames import transformed
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.initialise import InitialisationConfig, first_states
from objgraph.graph.solve import Problem, SolverConfig
from objgraph.maps.entry import failed_entry, map_entry, with_trust
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.maps.other_estimate import OtherEstimate
from objgraph.observation.floor import estimate_floor
from objgraph.observation.frames import FrameSource, Instance, Scan, frame_of
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.observation.view_selection import ViewIndex, ViewSelectionConfig, summarize
from objgraph.priors.mesh import RESOLUTION, RESOLUTIONS
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import load_prior_file
from objgraph.trust.calibration import Calibration, load_calibration, shipped_calibration
from objgraph.work import Engine, Workers, prepare, spread

log = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""(what is being done, done, of how many)."""


@dataclass(frozen=True)
class MappingConfig:
    """All settings of a mapping run."""

    views: int = 3
    """Views of each object."""
    seed: int = 0
    """Of everything that is sampled."""
    mesh_resolution: int = RESOLUTION
    """Cells along an edge of the canonical cube."""
    priors: tuple[str, ...] = ()
    """Your own priors, .safetensors files: each serves its category in place of the shipped one."""
    view: ViewSelectionConfig = field(default_factory=ViewSelectionConfig)
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    initialisation: InitialisationConfig = field(default_factory=InitialisationConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)
    heading_modes: HeadingModesConfig | None = field(default_factory=HeadingModesConfig)
    """The search for other headings; None takes the one that was found as the only one."""
    estimator: Literal["graph", "adam", "both"] = "graph"
    """Who estimates: the factor graph, the paper's gradient descent, or both; of both, the map takes the graph's
    and keeps the other beside it."""
    adam: AdamConfig = field(default_factory=AdamConfig)
    """Settings of the paper's."""
    calibration: str = ""
    """A file of `objgraph calibrate` that says how far objects are to be trusted; by default the shipped one does."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind, or there is no such estimator."""
        checks.settings(self, ConfigError, views=checks.Range(1), mesh_resolution=RESOLUTIONS)


@dataclass
class _Clock:
    """Wall time by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str):
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def map_scan(
    scan: Scan,
    config: MappingConfig | None = None,
    progress: Progress | None = None,
    watch: Callable[[Problem], None] | None = None,
    jobs: int = 1,
    engine: Engine = "local",
) -> ObjectMap:
    """Map every object that the scan's masks name; an object that fails says why and stops no other.

    The ground truth of the scan, if it has any, is not read. `watch` is called after each accepted step of the graph's
    solver, with the problem of the object as it then is. `jobs` objects are mapped at the same time, each in a process
    with one thread (so a script keeps its own work under `if __name__ == "__main__"`); the map does not depend on it.
    The engine "ray" asks the workers of a Ray cluster (`objgraph.work.ray_cluster`).

    Raises:
        ObservationError: the scan has no frame, or one that is none.
        PriorError: one of the files of `config.priors` is no prior.
        CovarianceError: `config.calibration` is no calibration.
        ConfigError: `jobs` is not positive, there is no such engine, or one cannot `watch` so many.
        ProcessError: there is no Ray cluster.
    """
    config = checks.settings_or_default(config, MappingConfig, ConfigError)
    jobs = Workers(jobs, engine).jobs  # what is none is told before the frames are read
    if watch is not None and (jobs > 1 or engine != "local"):
        raise ConfigError("a watched map is made in one process: jobs=1")
    checks.instance("scan", scan, Scan, ObservationError)
    if not len(scan.frames):
        raise ObservationError(f"scan {scan.name} has no frame; give it some")
    given = [load_prior_file(Path(path)) for path in config.priors]
    find_prior = partial(prior_for, given=given)
    calibration_of(config)  # a file that is none is told before the work
    tell = progress or (lambda what, done, total: None)
    if jobs > 1 and engine == "local":
        prepare(__name__)
    index = summarize(scan.frames, config.view, lambda done, total: tell("reading frames", done, total))
    floor = scene_floor(scan)
    count, entries = len(scan.instances), {}

    def works() -> Iterator[Callable[[], MappedObject]]:
        for instance in scan.instances:
            tell(f"mapping {instance.category} {instance.id}", len(entries), count)
            yield _work(scan, instance, index, floor, config, find_prior, watch)

    for place, entry in spread(works(), Workers(min(jobs, max(count, 1)), engine)):
        instance = scan.instances[place]
        entry = failed_entry(instance, entry) if isinstance(entry, ProcessError) else entry
        entries[place] = entry
        tell(f"{entry.status} {instance.category} {instance.id}", len(entries), count)
    tell("mapped", count, count)
    return ObjectMap(scan.name, tuple(entries[place] for place in range(count)), scan.up_world)


def _work(
    scan: Scan,
    instance: Instance,
    index: ViewIndex,
    floor: float | None,
    config: MappingConfig,
    find_prior: Callable[[str], ShapePrior],
    watch: Callable[[Problem], None] | None,
) -> Callable[[], MappedObject]:
    """What is left to be done for an object once it has been observed; a failure is in the result, not raised."""
    clock = _Clock()
    try:
        prior = find_prior(instance.category)
        with clock.stage("observe"):
            views = observe_instance(scan.frames, instance, index, config)
    except ObjectGraphError as error:
        return partial(failed_entry, instance, error, clock.seconds)
    return partial(_mapped, instance, prior, views, scan.up_world, floor, config, clock, watch)


def _mapped(
    instance: Instance,
    prior: ShapePrior,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    config: MappingConfig,
    clock: _Clock,
    watch: Callable[[Problem], None] | None,
) -> MappedObject:
    """`map_object`, whose failure is in the result."""
    try:
        return map_object(instance, prior, views, up_world, floor, config, clock, watch)
    except ObjectGraphError as error:
        return failed_entry(instance, error, clock.seconds)


def map_object(
    instance: Instance,
    prior: ShapePrior,
    views: Sequence[ObjectView],
    up_world: Float[np.ndarray, "3"],
    floor: float | None,
    config: MappingConfig,
    clock: _Clock | None = None,
    watch: Callable[[Problem], None] | None = None,
) -> MappedObject:
    """Initialise, solve, and describe one object from its views.

    Raises:
        InitialisationError, SolveError, FactorError: the object cannot be mapped; the message says why.
    """
    clock = clock or _Clock()
    with clock.stage("initialise"):
        builder = ObjectBuilder(config.graph, up_world, floor)
        first = first_states(prior, views, builder, config.initialisation)
    name = f"{instance.category} {instance.id}"
    task = EstimationTask(name, prior, first.states, tuple(views), up_world, floor, chances=first.chances)
    with clock.stage("solve"):
        main, *rest = _estimators(config, watch)
        estimate = _estimated(main, task)
        other = _beside(rest[0], task) if rest else None
    with clock.stage("mesh"):
        entry = map_entry(instance, prior, estimate, views, config.mesh_resolution)
        entry = with_trust(entry, task, estimate, calibration_of(config))
    return replace(
        entry,
        estimator="adam" if config.estimator == "adam" else "graph",
        other=other,
        linearizations=estimate.linearizations + sum(p.linearizations for p in first.tried),
        error_evaluations=estimate.error_evaluations + sum(p.error_evaluations for p in first.tried),
        seconds=sum(clock.seconds.values()),
        seconds_by_stage=clock.seconds,
    )


def _estimators(config: MappingConfig, watch: Callable[[Problem], None] | None = None) -> list[Estimator]:
    """The one whose estimate the map takes, then the one that stands beside it."""
    graph = GraphEstimator(config.graph, config.solver, config.heading_modes, watch=watch)
    adam = AdamEstimator(config.adam)
    return {"graph": [graph], "adam": [adam], "both": [graph, adam]}[config.estimator]


def _estimated(estimator: Estimator, task: EstimationTask) -> Estimate:
    (result,) = estimator.estimate([task])
    if isinstance(result, SolveError):
        raise result
    return result


def _beside(estimator: Estimator, task: EstimationTask) -> OtherEstimate | None:
    """The second estimate; where it fails the first one stands alone."""
    try:
        estimate = _estimated(estimator, task)
    except SolveError as error:
        log.warning("only one estimator succeeded: %s", error)
        return None
    state, covariance = estimate.state, estimate.covariance
    assert covariance is not None  # both that a map can take give one
    return OtherEstimate(
        covariance.source,
        state.T_world_object.matrix(),
        state.scale,
        state.code,
        covariance.rigid,
        np.sqrt(np.diag(covariance.code)),
    )


def calibration_of(config: MappingConfig) -> Calibration:
    """The one of the settings, or the shipped one; raises CovarianceError where the file is none."""
    return load_calibration(Path(config.calibration)) if config.calibration else shipped_calibration()


def observe_instance(
    frames: FrameSource, instance: Instance, index: ViewIndex, config: MappingConfig
) -> list[ObjectView]:
    """The views of an object by the selection rule; one that cannot be used is left out with a warning."""
    views, reasons = [], []
    for i in index.select(instance.id, config.views):
        try:
            views.append(observe(frames[i], instance.id, config.sampling, seed=config.seed + i))
        except ObservationError as error:
            log.warning("a view is left out: %s", error)
            reasons.append(str(error))
    if not views:
        raise InitialisationError(f"{instance.category} {instance.id}: no view can be used: {reasons[0]}")
    return views


def scene_floor(scan: Scan, frames: int = 12, pixels: int = 4000) -> float | None:
    """Height of the floor along the scan's up direction, from a few frames' depth; None where it is not seen."""
    chosen = np.unique(np.linspace(0, len(scan.frames) - 1, min(frames, len(scan.frames))).astype(int))
    return estimate_floor(scene_points(scan, chosen, pixels)[0], scan.up_world)


def scene_points(
    scan: Scan, frames: Sequence[int] | np.ndarray, pixels: int, seed: int = 0
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"] | None]:
    """World points of some pixels of some frames, and their colours in 0..1 where the frames have any."""
    rng = np.random.default_rng(seed)
    points, colors = [], []
    for i in frames:
        frame = frame_of(scan.frames, int(i))
        v, u = np.nonzero((frame.depth > 0) & np.isfinite(frame.depth) & (frame.depth < 8.0))
        some = rng.permutation(len(v))[:pixels]
        v, u = v[some], u[some]
        p_camera = frame.intrinsics.backproject(u, v) * frame.depth[v, u, None]
        points.append(transformed(frame.T_world_camera, p_camera))
        if frame.color is not None:
            rows = np.minimum(v * frame.color.shape[0] // frame.intrinsics.height, frame.color.shape[0] - 1)
            columns = np.minimum(u * frame.color.shape[1] // frame.intrinsics.width, frame.color.shape[1] - 1)
            colors.append(frame.color[rows, columns] / 255.0)
    whole = len(colors) == len(points)
    return np.concatenate(points), np.concatenate(colors) if whole else None
