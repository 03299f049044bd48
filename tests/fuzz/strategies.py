"""Wrong inputs made of right ones."""

import copy
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import note
from hypothesis import strategies as st

NUMBERS = st.one_of(
    st.integers(-3, 3),
    st.sampled_from([2**31, -(2**63), 10**400, 1e308, -1e-308, float("nan"), float("inf"), -float("inf")]),
    st.floats(),
)
LEAVES = st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=8), st.sampled_from(["", "0", "../x"]))
WORDS = ["nan", "inf", "-inf", "1e400", "0", "-1", "1", "9" * 30, "x", "", "../x", "/", "#", "\0", "1,2", ":"]
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=6,
)
"""What JSON, as Python writes it, can hold."""


@st.composite
def changed(draw: st.DrawFn, document: Any) -> Any:
    """A JSON document in which up to three places hold something else, are gone, or are there twice."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        places = list(_places(document))
        if not places:
            return draw(VALUES)
        inside, key = draw(st.sampled_from(places))
        what = draw(st.sampled_from(["other", "scaled", "gone", "twice"]))
        note(f"{what}: {key!r} of {str(inside)[:60]}")
        if what == "gone":
            del inside[key]
        elif what == "twice" and isinstance(inside, list):
            inside.append(copy.deepcopy(inside[key]))
        elif what == "scaled" and isinstance(inside[key], (int, float)):
            factor = draw(st.sampled_from([-1, 0, 1e-9, 1e9, 1e300]))
            with suppress(OverflowError):  # of an integer that no float holds
                inside[key] = inside[key] * factor
        else:
            inside[key] = draw(VALUES)
    return document


def _places(document: Any):
    """Every container of a document, with each of its keys."""
    keys = (
        document if isinstance(document, dict) else range(len(document)) if isinstance(document, list) else ()
    )
    for key in keys:
        yield document, key
        yield from _places(document[key])


@st.composite
def garbled(draw: st.DrawFn, data: bytes) -> bytes:
    """A file's bytes, cut off, or with up to four stretches overwritten, put in or left out."""
    if draw(st.booleans()) and draw(st.booleans()):
        return data[: draw(st.integers(0, len(data)))]
    for _ in range(draw(st.integers(1, 4))):
        # headers decide more than what comes after
        end = draw(st.sampled_from([min(64, len(data)), min(1000, len(data)), len(data)]))
        at = draw(st.integers(0, end))
        over, new = draw(st.integers(0, 8)), draw(st.binary(max_size=8))
        note(f"at {at}: {data[at : at + over]!r} becomes {new!r}")
        data = data[:at] + new + data[at + over :]
    return data


def encoded(document: Any) -> bytes:
    return json.dumps(document).encode()


class Content(bytes):
    """Of a file; short where a test that fails tells what it was given."""

    def __repr__(self) -> str:
        return super().__repr__() if len(self) < 300 else f"<{len(self)} bytes, see the notes>"


@st.composite
def reworded(draw: st.DrawFn, data: bytes) -> bytes:
    """A text in which up to three words or lines are others, gone, or there twice."""
    lines = [line.split(b" ") for line in data.split(b"\n")]
    for _ in range(draw(st.integers(1, 3))):
        line = draw(st.sampled_from(lines))
        i = draw(st.integers(0, max(len(line) - 1, 0)))
        what = draw(st.sampled_from(["other", "gone", "twice", "line gone", "line twice"]))
        note(f"{what}: word {i} of {b' '.join(line)[:80]!r}")
        if what == "other":
            line[i : i + 1] = [draw(st.sampled_from(WORDS) | LEAVES.map(str)).encode(errors="replace")]
        elif what == "gone":
            del line[i : i + 1]
        elif what == "twice":
            line[i:i] = line[i : i + 1]
        elif what == "line gone":
            line.clear()
        else:
            lines.append(list(line))
    return b"\n".join(b" ".join(line) for line in lines)


@st.composite
def damaged(draw: st.DrawFn, path: Path) -> Content | None:
    """What a file may hold in place of what it does; None for no file."""
    data = path.read_bytes()
    how = draw(st.sampled_from(["gone", "garbled", "kind", "kind", "kind"]))
    if how == "gone":
        return None
    if how == "kind" and path.suffix == ".json":
        return Content(encoded(draw(changed(json.loads(data)))))
    if how == "kind" and path.suffix in (".txt", ".csv", ".obj", ".off", ".yaml"):
        return Content(draw(reworded(data)))
    return Content(draw(garbled(data)))


@st.composite
def arrays(draw: st.DrawFn, good: np.ndarray) -> Any:
    """In place of an array: another shape, type or layout, bad entries, or no array at all."""
    array = good.copy()
    for _ in range(draw(st.integers(1, 2))):
        what = draw(st.sampled_from(["entry", "shape", "type", "layout", "scaled", "none"]))
        if what == "entry" and array.size:
            array = array.copy()  # a layout may be one that cannot be written
            value = draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, -1.0, 0.0]))
            array = array.copy()
            with np.errstate(all="ignore"):
                array.flat[draw(st.integers(0, array.size - 1))] = np.array(value).astype(array.dtype)
        elif what == "shape":
            shapes = [array[:0], array[..., :-1], array[None], array.ravel(), array.T, array[..., :0]]
            array = draw(st.sampled_from([each for each in shapes if isinstance(each, np.ndarray)]))
        elif what == "type" and array.dtype.kind in "fiub":
            kind = draw(st.sampled_from([np.float16, np.int8, np.uint8, np.complex64, object, bool, str]))
            with np.errstate(all="ignore"), suppress(ValueError):  # text that is no number
                array = array.astype(kind)
        elif what == "layout":
            array = np.asfortranarray(array)[::-1]
            array.flags.writeable = False
        elif what == "scaled" and array.dtype.kind in "fiu":
            with np.errstate(all="ignore"):
                array = (array * draw(st.sampled_from([-1.0, 0.0, 1e-12, 1e12]))).astype(array.dtype)
        else:
            return draw(st.one_of(VALUES, st.just([[1.0, 2.0], [3.0]])))
    return array
