"""Points of a PCD file (Point Cloud Library, version 0.7): ascii, binary, or binary compressed.

Read here and not by open3d, which believes what a file says of its own size and then reads beyond the memory that it has.
"""

import struct
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

_KINDS = {"F": "f", "I": "i", "U": "u"}
_SIZES = (1, 2, 4, 8)
_MOST_FIELDS = 1000
_LONGEST_HEADER = 2**16
_LARGEST = 2**30
"""Bytes of points, unpacked."""


def parse_pcd(data: bytes) -> Float[np.ndarray, "n 3"]:
    """x, y and z of all points; raises ValueError, with the reason, where the file is damaged or has none."""
    header, body = _header(data)
    fields, count = _fields(header), _number(header, "POINTS")
    form = header["DATA"][0] if header["DATA"] else ""
    width = sum(kind.itemsize for kind, _ in fields.values())
    if form == "ascii":
        return _ascii(body, fields, count)
    if form == "binary_compressed":
        body = _unpacked(body, width * count)
    elif form != "binary":
        raise ValueError(f"DATA {form!r} is none of ascii, binary and binary_compressed")
    if len(body) < width * count or not count:
        raise ValueError(f"{len(body)} bytes are not {count} points of {width}: truncated or empty")
    places = {name: offset for name, (_, offset) in fields.items()}
    columns = []
    for name in "xyz":
        kind = fields[name][0]
        if form == "binary":  # point by point
            column = np.ndarray((count,), kind.base, body, places[name], (width,))
        else:  # field by field
            column = np.ndarray((count,), kind.base, body, places[name] * count, (kind.itemsize,))
        columns.append(column.astype(float))
    return np.column_stack(columns)


def _header(data: bytes) -> tuple[dict[str, list[str]], bytes]:
    """Its lines by their first word, and what comes after the last."""
    found: dict[str, list[str]] = {}
    start = 0
    while start < min(len(data), _LONGEST_HEADER):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        words = data[start:end].decode("ascii", errors="replace").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            found[words[0]] = words[1:]
        if words and words[0] == "DATA":
            return found, data[start:]
    raise ValueError("no PCD header")


def _fields(header: Mapping[str, list[str]]) -> dict[str, tuple[np.dtype, int]]:
    """Type and offset in a point by name, of one element or of several."""
    names = header.get("FIELDS", [])
    counts = header.get("COUNT", ["1"] * len(names))
    columns = (names, header.get("SIZE", []), header.get("TYPE", []), counts)
    if not 0 < len(names) < _MOST_FIELDS or len({len(each) for each in columns}) != 1:
        raise ValueError("FIELDS, SIZE, TYPE and COUNT do not fit each other")
    found: dict[str, tuple[np.dtype, int]] = {}
    offset = 0
    for i, (name, size, kind, count) in enumerate(zip(*columns, strict=True)):
        if kind not in _KINDS or int(size) not in _SIZES or not 0 < int(count) < 2**16:
            raise ValueError(f"field {name} of type {kind}, size {size} and count {count} is none")
        if kind == "F" and int(size) == 1:
            raise ValueError(f"field {name} is a float of one byte")
        own = np.dtype((f"<{_KINDS[kind]}{size}", (int(count),)))
        found[name if name not in found else f"{name} {i}"] = own, offset  # "_" pads, and may do so twice
        offset += own.itemsize
    if missing := [name for name in "xyz" if name not in found]:
        raise ValueError(f"has no field {', '.join(missing)}")
    return found


def _number(header: Mapping[str, list[str]], name: str) -> int:
    words = header.get(name, [])
    if len(words) != 1 or int(words[0]) < 0:
        raise ValueError(f"{name} is missing or no number")
    return int(words[0])


def _ascii(body: bytes, fields: Mapping[str, tuple[np.dtype, int]], count: int) -> Float[np.ndarray, "n 3"]:
    words = body.split()
    lengths = [int(np.prod(kind.shape)) for kind, _ in fields.values()]
    width, starts = sum(lengths), dict(zip(fields, np.cumsum([0, *lengths]).tolist(), strict=False))
    if len(words) < width * count or not count:
        raise ValueError(f"{len(words)} words are not {count} points of {width}: truncated or empty")
    columns = [np.array(words[starts[name] : width * count : width], dtype=float) for name in "xyz"]
    return np.column_stack(columns)


def _unpacked(body: bytes, size: int) -> bytes:
    """LZF (Lehmann, liblzf): runs of literals, and copies of what was there before."""
    if len(body) < 8:
        raise ValueError("truncated")
    packed, claimed = struct.unpack_from("<II", body)
    data = body[8 : 8 + packed]
    if len(data) != packed or claimed != size or size > _LARGEST:
        raise ValueError(f"truncated, or {claimed} bytes are not those of its points, {size}")
    data += bytes(2)  # so that one that is cut off within a copy is found by its length
    out, at = bytearray(), 0
    while at < packed and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length, at = ((control >> 5) + 2, at) if control < 224 else (9 + data[at], at + 1)
        back = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        if back < 0:
            raise ValueError("its compressed points refer to what is not there")
        copied = out[back : back + length]
        out += (copied * -(-length // len(copied)))[:length]  # it may run into what it writes
    if at > packed or len(out) != size:
        raise ValueError(f"its compressed points are {len(out)} bytes in place of {size}")
    return bytes(out)
