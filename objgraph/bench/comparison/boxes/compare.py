"""Every method on the detected objects of single scans, from the same points and the same start."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from objgraph.bench.comparison.boxes.detector_noise import scaled
from objgraph.bench.comparison.boxes.matching import LabelledBox, MatchConfig, heading_between_deg, matches
from objgraph.bench.comparison.boxes.rows import DETECTIONS, BoxRow
from objgraph.bench.comparison.contenders.methods import Clock, estimated, method
from objgraph.bench.comparison.objects.config import find_prior, settings_of
from objgraph.bench.comparison.running.store import Tell, complete, digest, plain
from objgraph.covariance.box import box_pose
from objgraph.datasets.kitti import CATEGORIES, detection_ids, frames, load_frame, load_labels
from objgraph.errors import DatasetError, EvaluationError, ObjectGraphError, ObservationError, SolveError
from objgraph.estimate import AdamEstimator, GaussNewtonEstimator
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate, EstimationTask, Estimator
from objgraph.geometry.boxes import OrientedBox, box_iou
from objgraph.maps.lidar_task import ROADS, LidarTaskConfig, task_of
from objgraph.metrics.placed import PlacedMesh
from objgraph.observation.lidar.frame import LidarFrame
from objgraph.observation.lidar.observe import LidarSamplingConfig
from objgraph.priors.mesh import RESOLUTION, extract_mesh
from objgraph.work import HERE, Workers

KITTI = "kitti"
"""The data set's name."""
ROWS = "boxes.jsonl"

_DENSE = LidarSamplingConfig(points=1000, free=1000)
"""As many as an iteration of the paper's estimator takes."""


@dataclass(frozen=True)
class LidarComparison:
    """What is compared on what."""

    root: Path
    """Of KITTI's layout."""
    methods: tuple[str, ...]
    out: Path
    """Folder of the rows."""
    scenes: tuple[str, ...] = ()
    """Frames by name; by default all."""
    seed: int = 0
    priors: tuple[str, ...] = ()
    """Your own priors, .safetensors files."""
    task: LidarTaskConfig = field(default_factory=LidarTaskConfig)
    match: MatchConfig = field(default_factory=MatchConfig)
    mesh_resolution: int = RESOLUTION
    detector_noise: float = 1.0
    """What the errors of the detections are multiplied by before anyone sees them (see `detector_noise.scaled`)."""

    @property
    def rows_of(self) -> tuple[str, ...]:
        """The methods, the detections themselves first."""
        return (DETECTIONS, *self.methods)


@dataclass(frozen=True)
class FrameJob:
    """One method on one frame."""

    comparison: LidarComparison
    method: str
    frame: str
    settings: str
    """Digest of the rows' settings."""
    version: str = ""

    @property
    def name(self) -> str:
        return f"{self.method} of frame {self.frame}"

    def rows(self) -> Iterator[BoxRow]:
        """See `measure`."""
        return measure(self)


def compare_boxes(
    comparison: LidarComparison,
    workers: Workers = HERE,
    retry_failed: bool = False,
    version: str = "",
    tell: Tell | None = None,
) -> list[BoxRow]:
    """A row for every method and detected object, and of the detections themselves; appended to `out` as they come.

    A frame's rows of a method that are all there already are not made again (with `retry_failed`, where one failed).

    Raises:
        EvaluationError: an unknown method; a folder that cannot be written or holds rows of other settings; a process
            that died.
        DatasetError: there are no frames, or one of those named does not exist.
    """
    settings = {name: row_settings(comparison, name) for name in comparison.rows_of}
    ids = {name: detection_ids(comparison.root, name) for name in _frames(comparison)}
    wanted = [(each, name, i) for each in settings for name in ids for i in ids[name]]

    def jobs(missing: Sequence[tuple[str, str, int]]) -> list[FrameJob]:
        left = {(each, name) for each, name, _ in missing}
        digests = {each: digest(settings[each]) for each in settings}
        return [
            FrameJob(comparison, each, name, digests[each], version)
            for name, each in product(ids, digests)
            if (each, name) in left
        ]

    return complete(comparison.out / ROWS, BoxRow, wanted, settings, jobs, workers, retry_failed, tell)


def row_settings(comparison: LidarComparison, name: str) -> dict[str, Any]:
    """All that a row of a method depends on; raises EvaluationError where there is no such method."""
    common = {
        "data": {"root": str(comparison.root.resolve())},
        "match": asdict(comparison.match),
        "seed": comparison.seed,
        "detector_noise": comparison.detector_noise,
    }
    if name == DETECTIONS:
        return common
    priors = {category: find_prior(category, comparison.priors) for category in CATEGORIES.values()}
    return common | {
        "task": settings_of(_task_config(comparison, name)),
        "mesh_resolution": comparison.mesh_resolution,
        "method": settings_of(estimator_of(name)),
        "priors": {category: str(prior.card.get("sha256")) for category, prior in priors.items()},
    }


def estimator_of(name: str) -> Estimator:
    """The method's estimator, for cars: rays are cut in a car's box, and a graph's stands on roads."""
    estimator = method(name).estimator()
    if isinstance(estimator, AdamEstimator | GaussNewtonEstimator):
        # the same box for all: a car's is a fifth of the cube
        steps = replace(estimator.config.steps, tight_box=True)
        return replace(estimator, config=replace(estimator.config, steps=steps))
    assert isinstance(estimator, GraphEstimator)
    return replace(estimator, graph=replace(ROADS, renderer=estimator.graph.renderer))


def measure(job: FrameJob) -> Iterator[BoxRow]:
    """The rows of a frame; whatever goes wrong with an object, or with reading the frame, is its rows' failure."""
    comparison = job.comparison
    blank = BoxRow(job.method, job.frame, 0, job.settings, version=job.version)
    try:
        frame, true = load_frame(comparison.root, job.frame), load_labels(comparison.root, job.frame)
    except DatasetError as error:
        for i in detection_ids(comparison.root, job.frame):
            yield replace(blank, detection=i, failure=str(error))
        return
    labels = [
        LabelledBox(i, CATEGORIES[box.type], box.T_rect_object, box.size)
        for i, box in enumerate(true, 1)
        if box.type in CATEGORIES
    ]
    # by the detections as they are: with any noise the same objects are compared
    matched = matches(frame.detections, labels, comparison.match)
    frame = replace(frame, detections=scaled(frame.detections, matched, comparison.detector_noise))
    rows = {
        each.id: _with_label(replace(blank, detection=each.id, category=each.category), frame, matched)
        for each in frame.detections
    }
    if job.method == DETECTIONS:
        for each in frame.detections:
            yield _with_box(rows[each.id], each.box, matched.get(each.id))
    else:
        yield from _estimated(frame, rows, matched, comparison, job.method)


def _estimated(
    frame: LidarFrame,
    rows: Mapping[int, BoxRow],
    matched: Mapping[int, LabelledBox],
    comparison: LidarComparison,
    name: str,
) -> Iterator[BoxRow]:
    """One method on all detections of a frame together; only what is done after it sees the labels."""
    config, clock = _task_config(comparison, name), Clock()
    tasks: dict[int, EstimationTask] = {}
    failures: dict[int, str] = {}
    for detection in frame.detections:
        try:
            prior = find_prior(detection.category, comparison.priors)
            tasks[detection.id] = task_of(frame, detection, prior, config, comparison.seed)
        except ObservationError as error:
            failures[detection.id] = str(error)
    results = estimated(estimator_of(name), list(tasks.values()))
    spent = clock.spent(len(tasks))
    for (number, task), result in zip(tasks.items(), results, strict=True):
        row = replace(rows[number], **spent)
        yield _measured(row, task, result, matched.get(number), comparison.mesh_resolution)
    for number, reason in failures.items():
        yield replace(rows[number], failure=reason)


def _measured(
    row: BoxRow,
    task: EstimationTask,
    result: Estimate | SolveError,
    label: LabelledBox | None,
    resolution: int,
) -> BoxRow:
    if isinstance(result, SolveError):
        return replace(row, failure=str(result))
    state = result.state
    try:
        mesh = extract_mesh(task.prior.decoder, state.code, resolution=resolution)
        vertices = np.asarray(mesh.vertices)
        placed = PlacedMesh(
            "estimate",
            state.T_world_object.matrix(),
            state.scale,
            vertices,
            np.asarray(mesh.faces),
        )
        if result.covariance is not None:
            known = box_pose(task.prior, state, result.covariance, vertices).covariance
            row = replace(row, sigma_m=plain(known.sigma[3:6]))
        return _with_box(row, placed.box, label)
    except ObjectGraphError as error:
        return replace(row, failure=str(error))


def _with_label(row: BoxRow, frame: LidarFrame, matched: Mapping[int, LabelledBox]) -> BoxRow:
    label = matched.get(row.detection)
    if label is None:
        return row
    inside = int(np.count_nonzero(label.box.contains(frame.p_world)))
    distance = np.linalg.norm(label.T_world_object[:3, 3] - frame.T_world_lidar[:3, 3])
    return replace(row, label=label.number, points=inside, distance_m=float(distance))


def _with_box(row: BoxRow, box: OrientedBox, label: LabelledBox | None) -> BoxRow:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = box.rotation, box.centre
    row = replace(row, T_world_object=plain(T), size_m=plain(box.extents))
    if label is None:
        return row
    return replace(
        row,
        iou=box_iou(box, label.box),
        error_m=plain(label.box.rotation.T @ (box.centre - label.box.centre)),
        heading_deg=heading_between_deg(T, label.T_world_object),
        size_error_m=plain(box.extents - label.size),
    )


def _task_config(comparison: LidarComparison, name: str) -> LidarTaskConfig:
    """The graph's sampling is the comparison's; the others sample as densely as they are meant to."""
    if isinstance(method(name).estimator(), GraphEstimator):
        return comparison.task
    dense = replace(comparison.task.sampling, points=_DENSE.points, free=_DENSE.free)
    return replace(comparison.task, sampling=dense)


def _frames(comparison: LidarComparison) -> Sequence[str]:
    known = frames(comparison.root)
    unknown = [name for name in comparison.scenes if name not in known]
    if unknown or not known:
        wrong = f"no frame '{unknown[0]}'" if unknown else "no frame at all"
        raise EvaluationError(f"{comparison.root}: {wrong} under training/velodyne")
    return comparison.scenes or known
