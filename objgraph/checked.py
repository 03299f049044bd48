"""What files hold, checked before anything is made of it.

All functions raise ValueError with the reason alone: loaders name the file and raise an error of their own type.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from jaxtyping import Float

T = TypeVar("T", bound=Any)

DEEPEST = 100
"""Levels of lists and objects in a JSON document."""
_LARGEST = 2**64
_SURROGATE = re.compile(r"\\ud[89a-f]", re.IGNORECASE)


def parse_json(data: bytes, finite: bool = True) -> Any:
    """A JSON document that can be walked, written and computed with.

    Integers fit a float and 64 bits, text is Unicode, no object has a name twice, and nothing is nested deeper than `DEEPEST`.
    `finite` refuses NaN and infinity, which Python alone reads.
    """
    try:
        text = data.decode(json.detect_encoding(data))
        document = json.loads(
            text,
            object_pairs_hook=_object,
            parse_int=_integer,
            parse_float=_finite if finite else float,
            parse_constant=_finite if finite else float,
        )
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if _SURROGATE.search(text):
        json.dumps(document, ensure_ascii=False).encode()  # half a character cannot be written
    _check_depth(document)
    return document


def whole(value: Any) -> int:
    """A whole number of a document, or what its text says."""
    if isinstance(value, str):
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or value % 1 != 0:
        raise ValueError(f"{value!r} is no whole number")
    return int(value)


def numbers(value: Any, *shape: int) -> np.ndarray:
    """Finite numbers of a document, in an array of this shape or of as many entries."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, OverflowError) as error:
        raise ValueError(f"{repr(value)[:40]} are no numbers") from error
    if array.size != math.prod(shape) or not np.isfinite(array).all():
        raise ValueError(f"{repr(value)[:40]} are not {' x '.join(map(str, shape))} finite numbers")
    return array.reshape(shape)


def direction(value: Any, name: str) -> Float[np.ndarray, "3"]:
    """A unit vector along three numbers that are not all zero, however large or small."""
    try:
        vector = numbers(value, 3)
        if not vector.any():
            raise ValueError("all are zero")
    except ValueError as error:
        raise ValueError(f"{name} must be three numbers, the direction against gravity: {error}") from error
    vector /= np.abs(vector).max()
    return vector / np.linalg.norm(vector)


def typed(kind: type[T], given: Any) -> T:
    """A flat dataclass of a document's values; TypeError where one is unknown, missing, or of another type."""
    known = {field.name: field.default for field in fields(kind) if field.default is not MISSING}
    check_fields({**known, **given}, get_type_hints(kind))
    return kind(**given)


def check_fields(document: Any, kinds: Mapping[str, Any]) -> None:
    """Raises TypeError where a document has not these fields of these types; one that may be None may be missing."""
    if not isinstance(document, dict):
        raise TypeError(f"a {type(document).__name__} in place of an object")
    for name, kind in kinds.items():
        if not fits(document.get(name), kind):
            words = kind.__name__ if isinstance(kind, type) else kind
            raise TypeError(f"{name} must be {words}, not {repr(document.get(name))[:40]}")


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of an annotated type; whole numbers are floats, too, and truths are no numbers."""
    origin, args = get_origin(kind), get_args(kind)
    if kind is Any or kind is None:
        return kind is Any or value is None
    if origin in (Union, UnionType):
        return any(fits(value, each) for each in args)
    if origin is Literal:
        return any(value == each for each in args)
    if kind in (int, float):
        return isinstance(value, int if kind is int else int | float) and not isinstance(value, bool)
    if origin in (list, tuple):
        return isinstance(value, origin) and all(fits(item, args[0]) for item in value)
    if origin is dict:
        return isinstance(value, dict) and all(fits(item, args[1]) for item in value.values())
    return isinstance(value, origin or kind)


def inside(folder: Path, name: Any) -> Path:
    """The path of a file that another one names, be it with backslashes; it, and what it is a link to, lies in the folder."""
    if not isinstance(name, str) or not name or "\0" in name:
        raise ValueError(f"{name!r} is no file's name")
    path = folder / name
    try:
        if not path.exists():
            path = folder / name.replace("\\", "/")  # as Windows has it
        within = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:  # links that go round in a circle, names that are too long
        raise ValueError(f"{name!r} is no file's name ({error})") from error
    if not within:
        raise ValueError(f"{name} lies outside of {folder}; move it into the folder")
    return path


def _check_depth(document: Any) -> None:
    level = [[document]]
    for _ in range(DEEPEST):
        items = (item for each in level for item in (each.values() if isinstance(each, dict) else each))
        level = [item for item in items if isinstance(item, dict | list)]
        if not level:
            return
    raise ValueError(f"nested deeper than {DEEPEST} levels")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Of a name that is there twice Python would keep the last."""
    document = dict(pairs)
    if len(document) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{next(name for name in names if names.count(name) > 1)!r} is there twice")
    return document


def _integer(text: str) -> int:
    if abs(number := int(text)) >= _LARGEST:
        raise ValueError(f"{text[:20]}.. has more than 64 bits")
    return number


def _finite(text: str) -> float:
    number = float(text)
    if number - number != 0:
        raise ValueError(f"{text[:20]} is no JSON number, it is not finite")
    return number
