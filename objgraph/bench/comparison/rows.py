"""One row an object, method and number of views, and the file that they are appended to as they come."""

import csv
import fcntl
import io
import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

from objgraph.errors import EvaluationError


class Row(Protocol):
    """What every comparison's rows have; they are dataclasses of JSON values."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def method(self) -> str: ...
    @property
    def settings(self) -> str:
        """Digest of all settings and weights that the row depends on."""
        ...

    @property
    def failure(self) -> str | None: ...
    @property
    def key(self) -> tuple:
        """What the row is of; of several the last holds."""
        ...


R = TypeVar("R", bound=Row)
Numbers = list[float] | None
Matrix = list[list[float]] | None
Key = tuple[str, str, int]
"""Method, case, views."""


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
    failure: str | None = None
    """Why there is no estimate, or none that can be measured; it counts as wrong by every criterion."""
    pose_correct: bool = False
    iou_correct: bool = False
    chamfer_correct: bool = False
    well_reconstructed: bool = False
    """See `objgraph.bench.comparison.measure.WELL_RECONSTRUCTED`."""
    translation_m: float | None = None
    rotation_deg: float | None = None
    scale_pct: float | None = None
    scale_pct_max: float | None = None
    box_iou: float | None = None
    volume_iou: float | None = None
    chamfer_m: float | None = None
    pearson: float | None = None
    """Of |SDF| and its standard deviation over points of the true surface."""
    spearman: float | None = None
    seconds: float | None = None
    """Of the estimation alone, by the clock."""
    seconds_cpu: float | None = None
    """The same in this process's processor time, which other processes do not lengthen."""
    seconds_initialise: float | None = None
    """Of what all methods start from."""
    cost_initial: float | None = None
    cost_final: float | None = None
    linearizations: int | None = None
    error_evaluations: int | None = None
    version: str = ""
    """Of the program that made the row."""
    start_T_world_object: Matrix = None
    """Where all methods began."""
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
    surface_error: Numbers = None
    """|SDF|, metres, at some points of the true surface."""
    surface_sigma: Numbers = None
    """Its standard deviation at the same points."""
    surface_residual: float | None = None
    """The decoder's own standard deviation there, metres."""
    box_error: Numbers = None
    """From the estimated box to the true one, over `objgraph.covariance.box.BOX_AXES`, modulo symmetry."""
    box_covariance: Matrix = None
    """9x9, over the same."""
    heading_error_deg: float | None = None
    """How far the object is turned about its up axis, modulo symmetry."""

    @property
    def key(self) -> Key:
        return (self.method, self.case, self.views)


_LONG = frozenset(
    field.name for field in fields(ObjectRow) if field.type in (Numbers, Matrix) or field.name == "frames"
)


class RowFile(Generic[R]):
    """Rows of one dataclass as lines of JSON, appended one by one; a line that a kill has torn is dropped.

    It is locked while it is open.

    Raises:
        EvaluationError: the file cannot be written, another process has it, or a line within it is damaged.
    """

    def __init__(self, path: Path, kind: type[R]) -> None:
        self.path, self.kind = path, kind
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
        except OSError as error:
            raise EvaluationError(f"{path} cannot be written: {error}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.rows = self._read()
        except BlockingIOError as error:
            self.close()
            raise EvaluationError(
                f"{path}: another run is writing here; wait for it or give another folder"
            ) from error
        except BaseException:
            self.close()
            raise

    def append(self, row: R) -> None:
        """Write a row so that it outlives a kill of this process."""
        self._file.write(json.dumps(asdict(row), allow_nan=False).encode() + b"\n")
        self._file.flush()
        self.rows.append(row)

    def done(self, retry_failed: bool = False) -> set[tuple]:
        """Keys of rows that need not be made again; of several of one key the last holds."""
        latest = {row.key: row for row in self.rows}
        return {key for key, row in latest.items() if row.failure is None or not retry_failed}

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self) -> list[R]:
        self._file.seek(0)
        data = self._file.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            self._file.truncate(whole)
        return [self._row(line, i) for i, line in enumerate(data[:whole].splitlines(), 1) if line.strip()]

    def _row(self, line: bytes, number: int) -> R:
        try:
            return self.kind(**json.loads(line))
        except (ValueError, TypeError) as error:
            raise EvaluationError(
                f"{self.path}, line {number}: damaged, or of another version ({error}); "
                "delete the line or give another folder"
            ) from error


def csv_text(rows: Iterable[ObjectRow]) -> str:
    """One line an object, without what is no single value."""
    names = [field.name for field in fields(ObjectRow) if field.name not in _LONG]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*names, "frames"])
    for row in rows:
        writer.writerow([*(getattr(row, name) for name in names), " ".join(map(str, row.frames))])
    return buffer.getvalue()


def write_text(text: str, path: Path) -> None:
    """Write atomically; raises EvaluationError where the file cannot be written."""
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        temporary.write_text(text)
        os.replace(temporary, path)
    except OSError as error:
        raise EvaluationError(f"{path} cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def plain(value: Any) -> Any:
    """Arrays as lists, with None for a number that is not finite."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if abs(value) < float("inf") else None
    return [plain(item) for item in value.tolist()] if hasattr(value, "tolist") else [plain(v) for v in value]
