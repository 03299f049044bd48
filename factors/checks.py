"""Checks of what a caller gives: each returns it cleaned, or raises a typed error that names it and says what is due."""

import math
import operator
from collections.abc import Iterable
from dataclasses import fields
from functools import cache
from types import UnionType
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import gtsam
import numpy as np

from factors.errors import FactorError, ObjectGraphError

Kind = TypeVar("Kind")
Error = type[ObjectGraphError]


class Range(NamedTuple):
    """Which numbers are allowed; of an open one the least is not."""

    least: float = 0.0
    most: float = math.inf
    open: bool = False

    def holds(self, value: Any) -> bool:
        return self.least <= value <= self.most and not (self.open and value == self.least)

    def __str__(self) -> str:
        least = f"more than {self.least:g}" if self.open else f"at least {self.least:g}"
        return least if self.most == math.inf else f"{least} and at most {self.most:g}"


ANY = Range(-math.inf)
NOT_NEGATIVE = Range()
POSITIVE = Range(0.0, open=True)
SHARES = Range(0.0, 1.0)
LENGTHS = Range(0.0, 1e6)
"""Metres or canonical units that mean something."""
DEVIATIONS = Range(1e-9, 1e6)
"""Standard deviations, metres, that have an inverse."""
PLACES = Range(-1e6, 1e6)
"""Coordinates, metres."""


def instance(what: str, value: Any, kind: type[Kind], error: Error = FactorError) -> Kind:
    """An object of that kind."""
    if not isinstance(value, kind):
        raise error(f"{what} must be of type {kind.__name__}, not {type(value).__name__}")
    return value


def settings_or_default(value: Any, kind: type[Kind], error: Error = FactorError) -> Kind:
    """The settings given, or the usual ones."""
    return kind() if value is None else instance("config", value, kind, error)


def number(what: str, value: Any, allowed: Range = ANY, error: Error = FactorError) -> float:
    """A finite number within a range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise error(f"{what} must be a number, not {_shown(value)}")
    if not abs(value) < math.inf or not allowed.holds(value) or abs(value) > 1e300:
        due = "finite" if allowed == ANY else str(allowed)
        raise error(f"{what} must be {due}, not {_shown(value)}")
    return float(value)


def whole(what: str, value: Any, allowed: Range = NOT_NEGATIVE, error: Error = FactorError) -> int:
    """A whole number within a range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise error(f"{what} must be a whole number, not {_shown(value)}")
    if not allowed.holds(value):
        raise error(f"{what} must be {allowed}, not {_shown(value)}")
    return int(value)


def text(what: str, value: Any, error: Error = FactorError) -> str:
    """A word or more, which can be written."""
    if not isinstance(value, str) or not value.strip():
        raise error(f"{what} must be text, not {_shown(value)}")
    return string(what, value, error)


def string(what: str, value: Any, error: Error = FactorError) -> str:
    """Text that can be written, be it empty: names of files that are no Unicode hold halves of characters."""
    try:
        instance(what, value, str, error).encode()
    except UnicodeEncodeError as problem:
        raise error(f"{what} {_shown(value)} is no Unicode text; rename it") from problem
    return value


def array(
    what: str,
    value: Any,
    shape: tuple[int | None, ...] | None,
    error: Error = FactorError,
    *,
    kinds: str = "fiu",
    finite: bool = True,
) -> np.ndarray:
    """An array of numbers; None in `shape` stands for any length, for all of it for any shape; `kinds` are NumPy's letters
    of its types."""
    try:
        found = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as problem:
        raise error(f"{what} is no array of numbers ({str(problem).splitlines()[0]})") from problem
    if found.dtype.kind not in kinds:
        names = {"f": "real", "i": "whole", "u": "whole", "b": "true or false"}
        due = " or ".join(dict.fromkeys(names[kind] for kind in kinds))
        raise error(f"{what} is an array of {found.dtype}; its entries must be {due}")
    if shape is not None and not _fits(found.shape, shape):
        due = ", ".join("any" if n is None else str(n) for n in shape)
        raise error(f"{what} has shape {found.shape} where ({due}) is due")
    if finite and not np.isfinite(found).all():
        raise error(f"{what} has entries that are not finite")
    return found


def _fits(found: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    return len(found) == len(shape) and all(want in (None, n) for want, n in zip(shape, found, strict=True))


def reals(
    what: str,
    value: Any,
    shape: tuple[int | None, ...] | None,
    allowed: Range = ANY,
    error: Error = FactorError,
) -> np.ndarray:
    """Finite numbers within a range, in double precision."""
    found = array(what, value, shape, error).astype(float)
    if found.size and not (allowed.holds(found.min()) and allowed.holds(found.max())):
        raise error(f"every entry of {what} must be {allowed}")
    return found


def shares(what: str, value: Any, count: int, error: Error = FactorError) -> np.ndarray:
    """One number in [0, 1] for all of `count`, or one for each."""
    found = reals(what, value, None, SHARES, error)
    if found.shape not in ((), (count,)):
        raise error(f"{what} has shape {found.shape} where one number or {count} are due")
    return found


def direction(what: str, value: Any, error: Error = FactorError) -> np.ndarray:
    """A vector of three made a unit one."""
    found = reals(what, value, (3,), error=error)
    length = np.linalg.norm(found)
    if not 1e-12 < length < np.inf:
        raise error(f"{what} must have a direction, not be {found}")
    return found if abs(length - 1) < 1e-9 else found / length


def pose(what: str, value: Any, error: Error = FactorError) -> gtsam.Pose3:
    """A finite pose."""
    found = instance(what, value, gtsam.Pose3, error)
    if not np.isfinite(found.matrix()).all():
        raise error(f"{what} is not finite")
    return found


def key(what: str, value: Any, error: Error = FactorError) -> int:
    """A GTSAM key."""
    try:
        found = operator.index(value)
    except TypeError as problem:
        raise error(f"{what} must be a key, a whole number, not {_shown(value)}") from problem
    if not 0 <= found < 2**64:
        raise error(f"{what} must be a key, from 0 to 2^64 - 1, not {_shown(found)}")
    return found


def keys(what: str, value: Any, error: Error = FactorError) -> list[int]:
    """A list of GTSAM keys."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise error(f"{what} must be a list of keys, not {_shown(value)}")
    return [key(f"{what}[{i}]", each, error) for i, each in enumerate(value)]


def tuple_of(what: str, value: Any, kind: type[Kind], error: Error = FactorError) -> tuple[Kind, ...]:
    """A list or a tuple of one kind of thing."""
    if not isinstance(value, (list, tuple)):
        raise error(f"{what} must be a list or a tuple of {kind.__name__}, not {_shown(value)}")
    return tuple(instance(f"{what}[{i}]", each, kind, error) for i, each in enumerate(value))


def covariance(what: str, value: Any, length: int | None, error: Error = FactorError) -> np.ndarray:
    """A symmetric positive definite matrix; what of it is asymmetric by rounding is evened out."""
    found = reals(what, value, (length, length), error=error)
    size = np.sqrt(np.abs(np.diag(found)))  # an entry is as large at most as its variances allow
    if found.shape[0] != found.shape[1] or (np.abs(found - found.T) > 1e-6 * np.outer(size, size)).any():
        raise error(f"{what} of shape {found.shape} is not symmetric")
    found = 0.5 * (found + found.T)
    try:
        np.linalg.cholesky(found)
    except np.linalg.LinAlgError as problem:
        raise error(f"{what} is not positive definite") from problem
    return found


def settings(given: Any, error: Error = FactorError, **ranges: Range) -> None:
    """Check a dataclass of settings against its annotations.

    Numbers must be finite and at least 0 unless `ranges` say otherwise, choices one of their own, groups of their kind.
    What another annotation says is not looked at.
    """
    hints = _hints(type(given))
    for field in fields(given):
        what = f"{type(given).__name__}.{field.name}"
        _setting(what, getattr(given, field.name), hints[field.name], ranges.get(field.name, Range()), error)


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _setting(what: str, value: Any, hint: Any, allowed: Range, error: Error) -> None:
    if get_origin(hint) in (Union, UnionType):
        if value is None and type(None) in get_args(hint):
            return
        kinds = [each for each in get_args(hint) if each is not type(None)]
        if len(kinds) > 1:
            return
        hint = kinds[0]
    if hint is float:
        number(what, value, allowed, error)
    elif hint is int:
        whole(what, value, allowed, error)
    elif get_origin(hint) is Literal:
        if not isinstance(value, str) or value not in get_args(hint):
            raise error(f"{what} must be one of {', '.join(map(str, get_args(hint)))}, not {_shown(value)}")
    elif get_origin(hint) is tuple:
        kinds, found = get_args(hint), instance(what, value, tuple, error)
        if Ellipsis not in kinds and len(found) != len(kinds):
            raise error(f"{what} must be {len(kinds)} values, not {_shown(value)}")
        for i, each in enumerate(found):
            _setting(f"{what}[{i}]", each, kinds[0], allowed, error)
    elif isinstance(hint, type) and hint.__module__ != "jaxtyping":
        instance(what, bool(value) if isinstance(value, np.bool_) else value, hint, error)


def _shown(value: Any) -> str:
    """In a line, however long it is."""
    words = repr(value).split("\n")[0]
    return words if len(words) <= 60 else f"{words[:60]}..."
