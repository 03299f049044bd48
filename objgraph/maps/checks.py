"""Checks of a map's fields: each returns the value cleaned or raises `MapError` naming `where`."""

from typing import Any

import numpy as np
from jaxtyping import Float

from objgraph.errors import MapError
from objgraph.geometry.frames import why_not_rigid


def array(where: str, value: Any, shape: tuple[int | None, ...], dtype: type) -> np.ndarray | None:
    """A read-only copy of finite numbers; None in `shape` stands for any length."""
    if value is None:
        return None
    try:
        numbers = np.array(value, float)
    except (
        TypeError,
        ValueError,
        OverflowError,
        RuntimeError,
    ) as error:  # the last of a tensor with a gradient
        raise MapError(f"{where} is no array of numbers ({error})") from error
    fits = len(shape) == numbers.ndim
    if not fits or any(want not in (None, n) for want, n in zip(shape, numbers.shape, strict=True)):
        wanted = " x ".join("any" if n is None else str(n) for n in shape)
        raise MapError(f"{where} has shape {numbers.shape} where {wanted} is expected")
    if not np.isfinite(numbers).all():
        raise MapError(f"{where} is not finite")
    numbers = numbers.astype(dtype)
    numbers.flags.writeable = False
    return numbers


def number(where: str, value: Any) -> float | None:
    """A finite number."""
    if value is None:
        return None
    try:
        if isinstance(value, str):
            raise TypeError("text")
        result = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise MapError(f"{where} is no number ({value!r})") from error
    if not np.isfinite(result):
        raise MapError(f"{where} is not finite ({result})")
    return result


def whole(where: str, value: Any) -> int | None:
    """A whole number, which a document can hold: of 64 bits at most."""
    result = value if isinstance(value, (int, np.integer)) else number(where, value)
    if result is None:
        return None
    if result != int(result):
        raise MapError(f"{where} is no whole number ({value!r})")
    if abs(int(result)) >= 2**64:
        raise MapError(f"{where} has more than 64 bits")
    return int(result)


def is_rigid(T: Float[np.ndarray, "4 4"]) -> bool:
    """Whether a matrix is a rotation and a translation, to the precision of a text file."""
    return why_not_rigid(T, 1e-4) is None
