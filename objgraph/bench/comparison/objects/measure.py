"""Every method on one object, from the same frames and the same start, measured against the ground truth."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import trimesh

from objgraph.bench.comparison.contenders.methods import Clock, StartKind, estimated, failure_of, method
from objgraph.bench.comparison.objects.cases import Case
from objgraph.bench.comparison.objects.config import ComparisonConfig, find_prior
from objgraph.bench.comparison.objects.rows import SHARED, ObjectRow, method_and_start
from objgraph.bench.comparison.objects.starts import Start, find_start
from objgraph.bench.comparison.objects.uncertainty import surface_errors
from objgraph.bench.comparison.running.store import plain
from objgraph.covariance.box import box_pose
from objgraph.covariance.box_modes import box_modes
from objgraph.datasets.ground_truth import AnnotatedScan, GroundTruth, TrueBox
from objgraph.errors import InitialisationError, ObjectGraphError, ObservationError, SolveError
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.maps.pipeline import scene_floor
from objgraph.metrics.box_error import box_error
from objgraph.metrics.objects import BoxEvaluation, Evaluation, evaluate_box, evaluate_object
from objgraph.metrics.placed import PlacedMesh
from objgraph.observation.frames import Frame
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.synthetic.photograph import MEASURED
from objgraph.trust.evidence import evidence_of
from objgraph.work import threads

log = logging.getLogger(__name__)

WELL_CHAMFER_M = 0.05
WELL_RECONSTRUCTED = (
    f"9-DoF pose, IoU and Chamfer distance correct, and Chamfer distance < {WELL_CHAMFER_M} m"
)
"""Which objects the correlation of error and uncertainty is averaged over."""


@dataclass(frozen=True)
class Job:
    """What is to be done of one case with one number of views."""

    case: Case
    dataset: str
    views: int
    todo: Mapping[str, str]
    """Contenders, and the digest of the settings of each one's row."""
    config: ComparisonConfig = field(default_factory=ComparisonConfig)
    version: str = ""
    """Of the program."""

    @property
    def name(self) -> str:
        return f"{self.case.id} with {self.views} view{'s' * (self.views > 1)}"

    def rows(self) -> Iterator[ObjectRow]:
        """See `measure`."""
        return measure(self, self.config, self.version)


@dataclass(frozen=True)
class _Seen:
    """An object as some frames show it."""

    scan: AnnotatedScan
    floor: float | None
    frames: Mapping[int, Frame]
    """By index into the scan."""
    truth: GroundTruth
    prior: ShapePrior


def measure(job: Job, config: ComparisonConfig, version: str = "") -> Iterator[ObjectRow]:
    """The rows of a job, as they are done; whatever goes wrong with an object is its row's failure."""
    case, views = job.case, job.views
    blank = ObjectRow(
        "", job.dataset, case.id, case.category, case.shape, views, "", [], seed=config.seed, version=version,
        difficulty=case.difficulty, shapes=case.shapes,
    )  # fmt: skip
    rows = {}
    for name, digest in job.todo.items():
        chosen, start = method_and_start(name)
        rows[name] = replace(blank, method=chosen, start=start, settings=digest)
    with threads(config.threads):
        try:
            scan = case.scan()
            frames = {i: scan.frames[i] for i in case.views(views)}
            truth = scan.ground_truth[case.instance.id]
            seen = _Seen(scan, scene_floor(scan), frames, truth, find_prior(case.category, config.priors))
            rows = {name: _with_truth(row, seen) for name, row in rows.items()}
            yield from _from_starts(case, seen, rows, config)
        except Exception as error:  # no object may stop the others
            log.debug("%s", case.id, exc_info=True)
            yield from (replace(row, failure=failure_of(error)) for row in rows.values())


def _from_starts(
    case: Case, seen: _Seen, rows: Mapping[str, ObjectRow], config: ComparisonConfig
) -> Iterator[ObjectRow]:
    """A row for every contender, from the best state that the initialisation finds or from its own."""

    @cache
    def views_of(sampling: SamplingConfig) -> list[ObjectView]:
        return _observe(case, seen.frames, sampling, config.seed)

    @cache
    def start_of(kind: StartKind) -> Start:
        views = views_of(config.sampling)
        return find_start(kind, seen.prior, views, seen.scan.up_world, seen.floor, config)

    done: dict[tuple[Any, ...], ObjectRow] = {}
    for row in rows.values():
        chosen = method(row.method)
        kind: StartKind = "best" if row.start == SHARED else chosen.start
        key = None
        try:
            start = start_of(kind)
            start = start.first() if row.start == SHARED else start
            key = row.method, kind, len(start.states), start.chances
            if key in done:
                # its own start is the shared one
                yield replace(done[key], start=row.start, settings=row.settings)
                continue
            row = replace(
                row,
                start_seconds=start.seconds,
                start_T_world_object=plain(start.states[0].T_world_object.matrix()),
                start_scale=plain(start.states[0].scale),
            )
            row = _estimated(row, case, seen, start, views_of(chosen.sampling), config)
        except Exception as error:  # nor may a method stop the others
            log.debug("%s: %s", case.id, row.contender, exc_info=True)
            row = replace(row, failure=failure_of(error))
        if key is not None:
            done[key] = row
        yield row


def _observe(
    case: Case, frames: Mapping[int, Frame], sampling: SamplingConfig, seed: int
) -> list[ObjectView]:
    """The views that can be used, drawn as a mapping run draws them."""
    views, reasons = [], []
    for i, frame in frames.items():
        try:
            views.append(observe(frame, case.instance.id, sampling, seed=seed + i))
        except ObservationError as error:
            reasons.append(str(error))
    if not views:
        raise InitialisationError(f"no view can be used: {reasons[0] if reasons else 'there is none'}")
    for reason in reasons:
        log.info("%s: a view is left out: %s", case.id, reason)
    return views


def _estimated(
    row: ObjectRow,
    case: Case,
    seen: _Seen,
    start: Start,
    views: Sequence[ObjectView],
    config: ComparisonConfig,
) -> ObjectRow:
    """The row of one method's estimate; only what is done after it sees the ground truth."""
    task = EstimationTask(
        case.id, seen.prior, start.states, tuple(views), seen.scan.up_world, seen.floor,
        chances=start.chances,
    )  # fmt: skip
    estimator, clock = method(row.method).estimator(), Clock()
    (estimate,) = estimated(estimator, [task])
    row = replace(row, **clock.spent())
    if isinstance(estimate, SolveError):
        return replace(row, failure=str(estimate))
    row = replace(row, **_description(estimate))
    try:
        mesh = extract_mesh(seen.prior.decoder, estimate.state.code, resolution=config.mesh_resolution)
        state, vertices = estimate.state, np.asarray(mesh.vertices)
        placed = PlacedMesh(
            "the estimate", state.T_world_object.matrix(), state.scale, vertices, np.asarray(mesh.faces)
        )
        evaluation = _evaluation(placed, seen.truth, config.seed)
        covered = {} if estimate.covariance is None else _uncertainty(estimate, mesh, seen, config)
        evidence, seen_sides = evidence_of(task, estimate, state.to_world(vertices))
    except ObjectGraphError as error:
        return replace(row, failure=str(error))
    box = {"centre_world": plain(placed.centre_world), "extents": plain(placed.extents)}
    shown = {"evidence": evidence.to_json(), "box_seen": plain(seen_sides)}
    return replace(row, **_verdict(evaluation), **box, **covered, **shown)


def _evaluation(placed: PlacedMesh, truth: GroundTruth, seed: int) -> BoxEvaluation:
    if isinstance(truth, TrueBox):
        return evaluate_box(placed, truth)
    return evaluate_object(placed.T_world_object, placed.scale, placed.vertices, placed.faces, truth, seed)


def _uncertainty(
    estimate: Estimate, mesh: trimesh.Trimesh, seen: _Seen, config: ComparisonConfig
) -> dict[str, object]:
    """What the covariance says of surface and box, beside how wrong they are."""
    assert estimate.covariance is not None
    box = box_pose(seen.prior, estimate.state, estimate.covariance, np.asarray(mesh.vertices))
    modes = box_modes(box, estimate.state, estimate.turns)
    of_box = {
        "box_error": plain(box_error(box, seen.truth).tangent),
        "box_covariance": plain(box.covariance.matrix),
        "box_modes": [
            [mode.probability, *plain(mode.axes.T @ box_error(mode.box, seen.truth).tangent)]
            for mode in modes
        ],
        "box_extents": plain(box.extents),
    }
    if isinstance(seen.truth, TrueBox):
        return of_box
    points, seed = config.surface_points, config.seed
    errors = surface_errors(seen.prior, estimate.state, estimate.covariance, seen.truth, points, seed)
    kept = errors.some(config.kept_points, config.seed)
    return of_box | {
        "pearson": errors.pearson,
        "pearson_binned": errors.pearson_binned,
        "spearman": errors.spearman,
        "surface_error": plain(kept.error.round(6)),
        "surface_sigma": plain(kept.sigma.round(6)),
        "surface_residual": float(seen.prior.residual_sigma * np.mean(errors.metres)),
    }


def _with_truth(row: ObjectRow, seen: _Seen) -> ObjectRow:
    return replace(
        row,
        frames=list(seen.frames),
        prior=seen.prior.digest,
        truth_T_world_object=plain(seen.truth.T_world_object),
        truth_scale=plain(seen.truth.scale),
        truth_symmetry=seen.truth.symmetry,
        quality=seen.truth.quality if isinstance(seen.truth, TrueBox) else None,
        **_conditions(seen),
    )


def _conditions(seen: _Seen) -> dict[str, Any]:
    """What of the scan is known to be wrong, over the frames that are viewed."""
    known = dict(seen.scan.conditions)
    if not known:
        return {}
    used = list(seen.frames)
    of_views = {name: np.array(known[name])[used] for name in MEASURED}
    # what is in the mask or in the object, of which precision and recall are shares
    union = 1 / of_views["mask_precision"].clip(1e-6) + 1 / of_views["mask_recall"].clip(1e-6) - 1
    return {
        "visible": float(known["visible"][max(used)]),
        "mask_iou": float((1 / union).mean()),
        **{name: float(of_views[name].mean()) for name in ("camera_error_m", "camera_error_deg")},
        "conditions": known,
    }


def _description(estimate: Estimate) -> dict[str, object]:
    state, covariance = estimate.state, estimate.covariance
    return {
        "T_world_object": plain(state.T_world_object.matrix()),
        "scale": plain(state.scale),
        "code": plain(state.code),
        "covariance": None if covariance is None else plain(covariance.rigid),
        "cost_initial": plain(float(estimate.cost_initial)),
        "cost_final": plain(float(estimate.cost_final)),
        "linearizations": int(estimate.linearizations),
        "error_evaluations": int(estimate.error_evaluations),
        "turns": None if estimate.turns is None else plain(estimate.turns.probability),
    }


def _verdict(evaluation: BoxEvaluation) -> dict[str, object]:
    of_box: dict[str, object] = {
        **{name: plain(value) for name, value in asdict(evaluation).items()},
        "iou_correct": evaluation.iou_correct,
    }
    if not isinstance(evaluation, Evaluation):
        return of_box
    correct = evaluation.pose_correct and evaluation.iou_correct and evaluation.chamfer_correct
    return of_box | {
        "chamfer_correct": evaluation.chamfer_correct,
        "well_reconstructed": correct and evaluation.chamfer_m < WELL_CHAMFER_M,
    }
