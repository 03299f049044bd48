"""Depth, colour and camera of ROS messages."""

from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from objgraph.datasets.files import decode_color, decode_depth, metric_depth
from objgraph.errors import DatasetError

_MILLIMETRES = 1000.0
_PNG = b"\x89PNG\r\n\x1a\n"
_HEADER = 12
"""Bytes before the PNG of a compressedDepth: an integer and two floats."""
_DEPTH = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_COLOR = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8UC4": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
}
"""Channels, and how they become RGB."""


def depth_of(message: Any, origin: object) -> Float[np.ndarray, "h w"]:
    """Metres, 0 for none, of an Image (16 bit millimetres, float metres) or a PNG (also of `compressedDepth`).

    Raises:
        DatasetError: it is of another encoding or damaged.
    """
    if hasattr(message, "format"):
        return _compressed_depth(message.data.tobytes(), message.format, origin)
    if message.encoding not in _DEPTH:
        raise DatasetError(
            f"{origin}: depth of encoding {message.encoding}; {', '.join(_DEPTH)} are read: name another topic"
        )
    values = _pixels(message, 1, _DEPTH[message.encoding], origin)[..., 0]
    return metric_depth(values, _MILLIMETRES) if values.dtype.kind == "u" else _known(values.astype(float))


def color_of(message: Any, origin: object) -> UInt8[np.ndarray, "h w 3"]:
    """RGB of an Image of 8-bit channels or of a CompressedImage; raises DatasetError."""
    if hasattr(message, "format"):
        return decode_color(message.data.tobytes(), origin)
    if message.encoding not in _COLOR:
        raise DatasetError(
            f"{origin}: colour of encoding {message.encoding}; {', '.join(_COLOR)} are read: name another topic, or "
            "'none' (--topic.color none)"
        )
    channels, code = _COLOR[message.encoding]
    pixels = np.ascontiguousarray(_pixels(message, channels, "u1", origin))
    return pixels if code is None else cv2.cvtColor(pixels, code).astype(np.uint8)


def camera_matrix(info: Any, rectified: bool, origin: object) -> Float[np.ndarray, "3 3"]:
    """The matrix of a CameraInfo, of its rectified images or of its own; raises DatasetError where it holds none."""
    P = np.array(_field(info, "p"), float).reshape(3, 4)[:, :3]
    K = P if rectified and P[0, 0] > 0 else np.array(_field(info, "k"), float).reshape(3, 3)
    if min(K[0, 0], K[1, 1]) <= 0 or min(info.width, info.height) < 1:
        raise DatasetError(
            f"{origin}: the camera is not calibrated (fx {K[0, 0]:g}, {info.width}x{info.height} pixels)"
        )
    return K


def is_distorted(info: Any) -> bool:
    return bool(np.any(np.asarray(_field(info, "d"), float)))


def _field(info: Any, name: str) -> Any:
    """ROS 1 writes these fields' names large."""
    return getattr(info, name, None) if hasattr(info, name) else getattr(info, name.upper())


def _compressed_depth(data: bytes, form: str, origin: object) -> Float[np.ndarray, "h w"]:
    if data.startswith(_PNG):
        return decode_depth(data, origin, _MILLIMETRES)
    if not data[_HEADER:].startswith(_PNG):
        raise DatasetError(f"{origin}: compressed depth of format '{form}' is no PNG; name another topic")
    if not form.startswith("32FC1"):
        return decode_depth(data[_HEADER:], origin, _MILLIMETRES)
    # floats are kept as a / depth + b, 0 for none
    a, b = np.frombuffer(data[4:_HEADER], "<f4").astype(float)
    raw = decode_depth(data[_HEADER:], origin, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _known(np.where(raw > 0, a / (raw - b), 0))


def _known(depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0.0)


def _pixels(message: Any, channels: int, kind: str, origin: object) -> np.ndarray:
    """Rows without what fills them up, (height, width, channels)."""
    kind = (">" if message.is_bigendian else "<") + kind
    row = message.width * channels * np.dtype(kind).itemsize
    if (
        min(message.height, message.width) < 1
        or message.step < row
        or len(message.data) != message.height * message.step
    ):
        raise DatasetError(
            f"{origin}: {len(message.data)} bytes in rows of {message.step} are no image of {message.width}x"
            f"{message.height} pixels, {message.encoding}"
        )
    rows = np.asarray(message.data).reshape(message.height, message.step)[:, :row]
    return np.frombuffer(rows.tobytes(), kind).reshape(message.height, message.width, channels)
