"""Rows on disk: what is there already is kept, what is missing is made, and rows of other settings are refused."""

import fcntl
import hashlib
import json
import logging
import os
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import Field, asdict
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

from objgraph.atomic import write_file
from objgraph.bench.comparison.running.runner import Job, run
from objgraph.checked import fits, parse_json, typed
from objgraph.errors import EvaluationError
from objgraph.work import HERE, Workers

log = logging.getLogger(__name__)

SETTINGS = "settings.json"

Tell = Callable[[str, int, int], None]
"""(what is being done, done, of how many)."""


class Row(Protocol):
    """What one method made of one object: a dataclass of JSON values."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def method(self) -> str: ...
    @property
    def settings(self) -> str: ...  # their digest
    @property
    def failure(self) -> str | None: ...
    @property
    def version(self) -> str: ...  # of the program
    @property
    def key(self) -> tuple[Any, ...]: ...  # the method and the object; of several rows of one the last holds
    @property
    def group(self) -> Hashable: ...  # rows of equal ones have the same settings
    @property
    def what(self) -> str: ...  # the object, in words


R = TypeVar("R", bound=Row)


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
            self._file = path.open("a+b", buffering=0)
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
        """Write a row so that it outlives a kill of this process; raises EvaluationError where that is impossible."""
        line, end = json.dumps(asdict(row), allow_nan=False).encode() + b"\n", self._file.seek(0, os.SEEK_END)
        try:
            while line:  # a disk takes part of it before it is full
                line = line[self._file.write(line) :]
        except OSError as error:
            self._file.truncate(end)
            raise EvaluationError(
                f"{self.path} cannot be written ({error}): the same command goes on from here"
            ) from error
        self.rows.append(row)

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
            return typed(self.kind, parse_json(line))
        except (ValueError, TypeError) as error:
            raise EvaluationError(
                f"{self.path}, line {number}: damaged, or of another version ({error}); "
                "delete the line or give another folder"
            ) from error


def complete(
    path: Path,
    kind: type[R],
    wanted: Sequence[tuple[Any, ...]],
    settings: Mapping[Any, Mapping[str, Any]],
    jobs: Callable[[Sequence[tuple[Any, ...]]], Sequence[Job[R]]],
    workers: Workers = HERE,
    retry_failed: bool = False,
    tell: Tell | None = None,
) -> list[R]:
    """The rows of the wanted keys, in their order: `jobs` makes those that are missing from the file.

    `settings` are those of each group of rows; with `retry_failed` a failed row counts as missing.

    Raises:
        EvaluationError: see `RowFile` and `run`; or the file holds rows of these groups that other settings made.
    """
    tell = tell or (lambda what, done, total: None)
    with RowFile(path, kind) as file:
        _check_settings(file, settings)
        latest = {row.key: row for row in file.rows}
        missing = [
            key for key in wanted if key not in latest or (retry_failed and latest[key].failure is not None)
        ]
        done = set(wanted).difference(missing)
        tell("estimating", len(done), len(wanted))
        for row in run(jobs(missing), workers):
            file.append(row)
            if row.failure is not None:
                log.warning("%s of %s failed: %s", row.method, row.what, row.failure)
            latest[row.key] = row
            done.add(row.key)
            tell(f"{row.method}: {row.what}", len(done), len(wanted))
    return [latest[key] for key in wanted]


def digest(settings: Mapping[str, Any]) -> str:
    """A short name of settings: equal ones have equal ones."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def write_text(text: str, path: Path) -> None:
    """Write atomically; raises EvaluationError where the file cannot be written."""
    write_file(path, text.encode(), EvaluationError)


def plain(value: Any) -> Any:
    """Arrays as lists, with None for a number that is not finite."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if abs(value) < float("inf") else None
    return [plain(item) for item in value.tolist()] if hasattr(value, "tolist") else [plain(v) for v in value]


def _check_settings(file: RowFile[Any], settings: Mapping[Any, Mapping[str, Any]]) -> None:
    """Refuse to mix, and note the settings beside the rows."""
    folder = file.path.parent
    noted = _read_settings(folder / SETTINGS)
    digests = {group: digest(each) for group, each in settings.items()}
    for row in file.rows:
        if row.settings != digests.get(row.group, row.settings):
            before, now = noted.get(row.settings), settings[row.group]
            words = ["not noted"] if before is None else _differences(before, now)
            raise EvaluationError(
                f"{folder} holds rows of '{row.method}' made with other settings or weights ({'; '.join(words)}): "
                "give another --out, or delete that folder"
            )
    noted |= {digests[group]: each for group, each in settings.items()}
    write_text(json.dumps(noted, indent=1) + "\n", folder / SETTINGS)


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        settings = parse_json(path.read_bytes())
        if not fits(settings, dict[str, dict[str, Any]]):
            raise ValueError("no settings by their digests")
        return settings
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise EvaluationError(f"{path} is damaged ({error}): delete it") from error


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Which settings differ, in words; `before` was read from JSON, which has no tuples."""
    a, b = _flat(before), _flat(json.loads(json.dumps(now)))
    return [
        f"{name}: {a.get(name, 'none')} before, {b.get(name, 'none')} now"
        for name in sorted(a.keys() | b.keys())
        if a.get(name) != b.get(name)
    ]


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(value, Mapping):
        return {name: value}
    parts = [_flat(item, f"{name}.{key}" if name else str(key)) for key, item in value.items()]
    return {key: item for part in parts for key, item in part.items()}
