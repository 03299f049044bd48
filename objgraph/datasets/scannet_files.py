"""The files of one ScanNet scan: both forms of its recording, its masks and its labels."""

import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float, UInt8

from objgraph.checked import whole
from objgraph.datasets.files import (
    ColorImages,
    decode_depth,
    intrinsics_from,
    read_bytes,
    read_json,
    read_matrix,
)
from objgraph.datasets.sens import SensFile
from objgraph.errors import DatasetError
from objgraph.observation.frames import Intrinsics

_MILLIMETRES = 1000.0
_LARGEST_IMAGE = 2**28
"""Bytes."""
_NUMBER_LINE = re.compile(r"^(\w+) = ([-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)\s*$", re.MULTILINE)


class Recording(Protocol):
    """What both forms of a recording give; a frame's name is its number."""

    names: list[str]

    def pose(self, name: str) -> Float[np.ndarray, "4 4"]:
        """Camera to world as recorded: perhaps NaN or infinity."""
        ...

    def depth(self, name: str) -> Float[np.ndarray, "h w"]:
        """z-depth in metres."""
        ...

    def color(self, name: str, shape: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"] | None:
        """RGB at the depth's resolution; None where the scan has none that can be used."""
        ...

    def intrinsics(self, shape: tuple[int, int]) -> Intrinsics:
        """The depth camera for images of `shape` (height, width)."""
        ...


class ExportedRecording:
    """The folders that ScanNet's SensReader exports."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        depth = {path.stem for path in (folder / "depth").glob("*.png")}
        self.names = sorted(depth, key=lambda name: (len(name), name))
        self._colors = ColorImages()

    def pose(self, name: str) -> Float[np.ndarray, "4 4"]:
        return read_matrix(self.folder / "pose" / f"{name}.txt", 4, 4)

    def depth(self, name: str) -> Float[np.ndarray, "h w"]:
        path = self.folder / "depth" / f"{name}.png"
        shift = self._info.get("depthShift", self._info.get("depth_shift", _MILLIMETRES))
        if not 0 < shift < np.inf:
            raise DatasetError(f"{self._info_path}: depth shift {shift} is no number of units a metre")
        return decode_depth(read_bytes(path), path, shift)

    def color(self, name: str, shape: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"] | None:
        path = self.folder / "color" / f"{name}.jpg"
        return self._colors.read(path if path.is_file() else None, shape)

    def intrinsics(self, shape: tuple[int, int]) -> Intrinsics:
        return intrinsics_from(self._camera, self._camera_path, shape[1], shape[0], self._size)

    @property
    def _camera_path(self) -> Path:
        return self.folder / "intrinsic" / "intrinsic_depth.txt"

    @cached_property
    def _camera(self) -> Float[np.ndarray, "4 4"]:
        return read_matrix(self._camera_path, 4, 4)

    @cached_property
    def _info(self) -> dict[str, float]:
        if not self._info_path.is_file():
            return {}
        text = read_bytes(self._info_path).decode("utf-8", errors="replace")
        return {key: float(value) for key, value in _NUMBER_LINE.findall(text)}

    @property
    def _info_path(self) -> Path:
        return self.folder / f"{self.folder.name}.txt"

    @property
    def _size(self) -> tuple[int, int] | None:
        """Width and height that the depth camera's matrix is for."""
        if not {"depthWidth", "depthHeight"} <= self._info.keys():
            return None
        try:
            return whole(self._info["depthWidth"]), whole(self._info["depthHeight"])
        except ValueError as error:
            raise DatasetError(f"{self._info_path}: no size of depth images: {error}") from error


class SensRecording:
    """The `.sens` file itself."""

    def __init__(self, path: Path) -> None:
        self.file = SensFile(path)
        self.names = [str(k) for k in range(len(self.file))]
        self._colors = ColorImages()

    def pose(self, name: str) -> Float[np.ndarray, "4 4"]:
        return self.file.pose(int(name))

    def depth(self, name: str) -> Float[np.ndarray, "h w"]:
        return self.file.depth(int(name))

    def color(self, name: str, shape: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"] | None:
        origin = f"{self.file.path}: frame {name}"
        return self._colors.made(lambda: self.file.color(int(name)), origin, shape)

    def intrinsics(self, shape: tuple[int, int]) -> Intrinsics:
        header = self.file.header
        return intrinsics_from(header.intrinsic_depth, self.file.path, shape[1], shape[0], header.depth_size)


def open_recording(folder: Path) -> Recording:
    """The exported folders where they are, else the `.sens` file."""
    sens = folder / f"{folder.name}.sens"
    if (folder / "depth").is_dir():
        return ExportedRecording(folder)
    if sens.is_file():
        return SensRecording(sens)
    raise DatasetError(
        f"{folder}: neither exported folders (depth/, pose/, intrinsic/) nor {sens.name} are here"
    )


def mask_reader(folder: Path) -> Callable[[str], tuple[bytes, str]]:
    """A function that gives a frame's encoded mask and where it comes from: folder or zip archive."""
    if (folder / "instance-filt").is_dir():
        return lambda name: _from_folder(folder / "instance-filt" / f"{name}.png")
    archive = folder / f"{folder.name}_2d-instance-filt.zip"
    if not archive.is_file():
        raise DatasetError(f"{folder}: no instance masks; put instance-filt/ or {archive.name} here")
    try:
        opened = zipfile.ZipFile(archive)
    except (OSError, ValueError, RuntimeError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{archive}: no readable zip archive ({error}); download it again") from error
    return lambda name: _from_zip(opened, archive, f"instance-filt/{name}.png")


def read_labels(folder: Path) -> dict[int, str]:
    """ScanNet's label of each objectId."""
    paths = [folder / f"{folder.name}{middle}.aggregation.json" for middle in ("", "_vh_clean")]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise DatasetError(f"{folder}: no {paths[0].name} (nor {paths[1].name}): it says what the masks show")
    try:
        return {whole(group["objectId"]): str(group["label"]) for group in read_json(path)["segGroups"]}
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(f"{path}: no aggregation ({type(error).__name__}: {error})") from error


def _from_folder(path: Path) -> tuple[bytes, str]:
    return read_bytes(path), str(path)


def _from_zip(archive: zipfile.ZipFile, path: Path, member: str) -> tuple[bytes, str]:
    try:
        if (size := archive.getinfo(member).file_size) > _LARGEST_IMAGE:
            raise DatasetError(
                f"{path}: {member} would unpack to {size} bytes: no mask of a frame is as large"
            )
        return archive.read(member), f"{path}: {member}"
    except (
        KeyError,
        OSError,
        EOFError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
    ) as error:
        raise DatasetError(f"{path}: {member} cannot be read ({error})") from error
