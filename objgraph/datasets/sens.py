"""ScanNet's `.sens` files: a scan's colour, depth and poses in one binary file, read a frame at a time.

Layout (SensorData version 4, little-endian): version, sensor name, four 4x4 matrices (intrinsic and extrinsic of
colour and of depth), two compression types, four image sizes, depth units a metre, number of frames; then each
frame's camera-to-world pose, two time stamps, two byte counts and the two compressed images.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, UInt8

from objgraph.datasets.files import check_pixels, decode_color, metric_depth
from objgraph.errors import DatasetError

VERSION = 4
_COLOR_COMPRESSIONS = {0: "raw", 1: "png", 2: "jpeg"}
_DEPTH_COMPRESSIONS = {0: "raw_ushort", 1: "zlib_ushort", 2: "occi_ushort"}
_FRAME_HEADER = struct.Struct("<16fQQQQ")
_LONGEST_NAME = 4096


@dataclass(frozen=True)
class SensHeader:
    """What a `.sens` file says about all its frames."""

    sensor: str
    intrinsic_color: Float[np.ndarray, "4 4"]
    intrinsic_depth: Float[np.ndarray, "4 4"]
    color_compression: str
    depth_compression: str
    color_size: tuple[int, int]
    """Width and height."""
    depth_size: tuple[int, int]
    """Width and height."""
    depth_shift: float
    """Depth units a metre."""
    frame_count: int


@dataclass(frozen=True)
class _Entry:
    """Where a frame lies in the file."""

    offset: int
    color_bytes: int
    depth_bytes: int
    T_world_camera: Float[np.ndarray, "4 4"]


class SensFile:
    """Random access to the frames of a `.sens` file.

    Opening it walks over the frames' headers and keeps poses and offsets; images are read when asked for.
    Raises `DatasetError`, naming the file and the frame, for a missing or truncated file, another version or
    an unknown compression.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("rb") as stream:
                self.header = self._read_header(stream)
                size = path.stat().st_size
                self._entries = [self._read_entry(stream, size, k) for k in range(self.header.frame_count)]
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read ({error.strerror})") from error

    def __len__(self) -> int:
        return len(self._entries)

    def pose(self, index: int) -> Float[np.ndarray, "4 4"]:
        """Camera to world as the file has it: perhaps NaN or infinity."""
        return self._entries[index].T_world_camera

    def depth(self, index: int) -> Float[np.ndarray, "h w"]:
        """z-depth in metres, 0 where there is none."""
        entry = self._entries[index]
        data = self._read(entry.offset + entry.color_bytes, entry.depth_bytes, index)
        origin = f"{self.path}: frame {index}"
        width, height = self.header.depth_size
        if self.header.depth_compression == "zlib_ushort":
            try:
                data = zlib.decompressobj().decompress(data, 2 * width * height + 1)
            except zlib.error as error:
                raise DatasetError(f"{origin}: depth cannot be decompressed ({error})") from error
        if len(data) != 2 * width * height:
            raise DatasetError(
                f"{origin}: depth has {len(data)} bytes instead of {width}x{height} 16-bit pixels"
            )
        return metric_depth(np.frombuffer(data, "<u2").reshape(height, width), self.header.depth_shift)

    def color(self, index: int) -> UInt8[np.ndarray, "h w 3"]:
        """RGB, as large as it was recorded."""
        entry = self._entries[index]
        data = self._read(entry.offset, entry.color_bytes, index)
        return decode_color(data, f"{self.path}: frame {index}")

    def _read(self, offset: int, count: int, index: int) -> bytes:
        try:
            with self.path.open("rb") as stream:
                stream.seek(offset)
                return self._exactly(stream, count, f"frame {index}")
        except OSError as error:
            raise DatasetError(f"{self.path}: frame {index} cannot be read ({error.strerror})") from error

    def _exactly(self, stream: BinaryIO, count: int, what: str) -> bytes:
        data = stream.read(count)
        if len(data) != count:
            raise DatasetError(f"{self.path}: truncated in {what}; download it again")
        return data

    def _unpack(self, stream: BinaryIO, layout: str) -> tuple:
        return struct.unpack(layout, self._exactly(stream, struct.calcsize(layout), "the header"))

    def _read_header(self, stream: BinaryIO) -> SensHeader:
        version, name_length = self._unpack(stream, "<IQ")
        if version != VERSION or name_length > _LONGEST_NAME:
            raise DatasetError(
                f"{self.path}: no ScanNet SensorData of version {VERSION} "
                f"(it says version {version}); only that is read"
            )
        sensor = self._exactly(stream, name_length, "the header").decode("utf-8", errors="replace")
        matrices = np.array(self._unpack(stream, "<64f")).reshape(4, 4, 4)
        color_code, depth_code = self._unpack(stream, "<ii")
        color_width, color_height, depth_width, depth_height = self._unpack(stream, "<4I")
        depth_shift, frame_count = self._unpack(stream, "<fQ")
        if not (np.isfinite(depth_shift) and depth_shift > 0):
            raise DatasetError(f"{self.path}: depth shift {depth_shift} is no number of units a metre")
        check_pixels(depth_width, depth_height, f"{self.path}: depth")
        return SensHeader(
            sensor,
            intrinsic_color=matrices[0],
            intrinsic_depth=matrices[2],
            color_compression=self._compression("colour", color_code, _COLOR_COMPRESSIONS, ("jpeg", "png")),
            depth_compression=self._compression(
                "depth", depth_code, _DEPTH_COMPRESSIONS, ("zlib_ushort", "raw_ushort")
            ),
            color_size=(color_width, color_height),
            depth_size=(depth_width, depth_height),
            depth_shift=float(depth_shift),
            frame_count=frame_count,
        )

    def _compression(self, image: str, code: int, names: dict[int, str], readable: tuple[str, ...]) -> str:
        name = names.get(code, "unknown")
        if name not in readable:
            raise DatasetError(
                f"{self.path}: {image} compression {code} ({name}) is not read; readable: {', '.join(readable)}"
            )
        return name

    def _read_entry(self, stream: BinaryIO, size: int, index: int) -> _Entry:
        what = f"frame {index} of {self.header.frame_count}"
        fields = _FRAME_HEADER.unpack(self._exactly(stream, _FRAME_HEADER.size, what))
        pose = np.array(fields[:16]).reshape(4, 4)
        color_bytes, depth_bytes = fields[18], fields[19]
        offset = stream.tell()
        if offset + color_bytes + depth_bytes > size:
            raise DatasetError(f"{self.path}: truncated in {what}; download it again")
        stream.seek(color_bytes + depth_bytes, 1)
        return _Entry(offset, color_bytes, depth_bytes, pose)
