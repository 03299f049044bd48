"""One row an object, method and number of views."""

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

Numbers = list[float] | None
Matrix = list[list[float]] | None
Key = tuple[str, str, int]
"""Contender, case, views."""
Conditions = dict[str, Any] | None
SHARED, OWN = STARTS = ("shared", "own")
_AT = "@"


def contender(method: str, start: str) -> str:
    """A method with its start in one word; that of the shared one is the method's name."""
    return method if start == SHARED else f"{method}{_AT}{start}"


def method_and_start(contender: str) -> tuple[str, str]:
    """The reverse of `contender`."""
    method, _, start = contender.partition(_AT)
    return method, start or SHARED


@dataclass(frozen=True)
class ObjectRow:
    """What one method made of one object. None where there is no such value; a failure has none at all."""

    method: str
    dataset: str
    case: str
    category: str
    shape: str
    """Objects of equal ones have the same CAD model."""
    views: int
    """Asked for; the object may have fewer."""
    settings: str
    """Digest of all settings and weights that this row depends on."""
    frames: list[int]
    """Indices of the frames that were observed."""
    start: str = SHARED
    """Where it began: `shared`, at the best of our initialisation, or `own`."""
    seed: int = 0
    """Of everything that was sampled."""
    prior: str = ""
    """Digest of the prior's weights."""
    difficulty: str = ""
    """Of a synthetic scan."""
    shapes: str = ""
    """The set of shapes that it is of."""
    visible: float | None = None
    """Share of the object's outer surface that the views together see."""
    camera_error_m: float | None = None
    """Mean of the views'."""
    camera_error_deg: float | None = None
    mask_iou: float | None = None
    """Mean of the views'."""
    conditions: Conditions = None
    """What is wrong with the scan: strengths as drawn, and what came of them in each view."""
    failure: str | None = None
    """Why there is no estimate, or none that can be measured; it counts as wrong by every criterion."""
    pose_correct: bool = False
    iou_correct: bool = False
    chamfer_correct: bool = False
    well_reconstructed: bool = False
    """See `objgraph.bench.comparison.objects.measure.WELL_RECONSTRUCTED`."""
    translation_m: float | None = None
    rotation_deg: float | None = None
    scale_pct: float | None = None
    scale_pct_max: float | None = None
    box_iou: float | None = None
    volume_iou: float | None = None
    chamfer_m: float | None = None
    recall: float | None = None
    """Share of the true surface within 2 cm of the estimated one."""
    centre_world: Numbers = None
    """Of the estimate's box."""
    extents: Numbers = None
    """Its edges along the object's axes, metres."""
    pearson: float | None = None
    """Of |SDF| and its standard deviation over points of the true surface."""
    pearson_binned: float | None = None
    """Of the standard deviation and the mean |SDF| in each of 100 bins of it."""
    spearman: float | None = None
    seconds: float | None = None
    """Of the estimation alone, by the clock."""
    seconds_cpu: float | None = None
    """The same in this process's processor time, which other processes do not lengthen."""
    start_seconds: float | None = None
    """Of finding its start, in processor time."""
    cost_initial: float | None = None
    cost_final: float | None = None
    linearizations: int | None = None
    error_evaluations: int | None = None
    version: str = ""
    """Of the program that made the row."""
    start_T_world_object: Matrix = None
    """Where it began."""
    start_scale: Numbers = None
    T_world_object: Matrix = None
    scale: Numbers = None
    """Metres per canonical unit along the object's axes."""
    code: Numbers = None
    covariance: Matrix = None
    """9x9: rotation, translation (both in the body frame), log-scale."""
    turns: Numbers = None
    """Probabilities of the heading and of those a quarter, a half and three quarters of a turn from it."""
    truth_T_world_object: Matrix = None
    truth_scale: Numbers = None
    truth_symmetry: int | None = None
    quality: str | None = None
    """Of a truth that is a box alone: `full`, or `partial` where not all of its sides were seen."""
    surface_error: Numbers = None
    """|SDF|, metres, at some points of the true surface."""
    surface_sigma: Numbers = None
    """Its standard deviation at the same points."""
    surface_residual: float | None = None
    """The decoder's own standard deviation there, metres."""
    box_error: Numbers = None
    """From the estimated box to the true one, over `objgraph.covariance.box.BOX_AXES`, modulo symmetry."""
    box_covariance: Matrix = None
    """9x9, over the same: the estimator's own, of the estimated heading alone."""
    box_extents: Numbers = None
    """Edges of that box, metres."""
    box_seen: Matrix = None
    """Share of the lower and the upper side along each of its axes that was seen."""
    box_modes: Matrix = None
    """Of each heading that it may have: its probability, and the error of its box in the axes of the estimate's."""
    evidence: Conditions = None
    """See `objgraph.trust.evidence.Evidence`."""
    heading_error_deg: float | None = None
    """How far the object is turned about its up axis, modulo symmetry."""

    @property
    def key(self) -> Key:
        return (self.contender, self.case, self.views)

    @property
    def contender(self) -> str:
        """The method with its start."""
        return contender(self.method, self.start)

    @property
    def group(self) -> tuple[str, str]:
        """Rows of equal ones have the same settings."""
        return (self.contender, self.category)

    @property
    def what(self) -> str:
        """The object, in words."""
        return f"{self.case}, {self.views} view{'s' * (self.views > 1)}"


_LONG = frozenset(
    field.name
    for field in fields(ObjectRow)
    if field.type in (Numbers, Matrix, Conditions) or field.name == "frames"
)


def csv_text(rows: Iterable[ObjectRow]) -> str:
    """One line an object, without what is no single value."""
    names = [field.name for field in fields(ObjectRow) if field.name not in _LONG]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, [*names, "frames"], extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(vars(row) | {"frames": " ".join(map(str, row.frames))} for row in rows)
    return buffer.getvalue()
