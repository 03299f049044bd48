"""What the sensor says about an object: frames, masks, and the points and rays sampled from them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from factors import checks
from objgraph.errors import ObservationError

SIZES = checks.Range(1, 65536)
"""Pixels along an edge of a picture."""


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion; pixel centres lie at integer coordinates."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        """Raises ObservationError where these are no numbers of pixels."""
        for name in ("fx", "fy"):
            checks.number(f"Intrinsics.{name}", getattr(self, name), checks.POSITIVE, ObservationError)
        for name in ("cx", "cy"):
            checks.number(f"Intrinsics.{name}", getattr(self, name), error=ObservationError)
        for name in ("width", "height"):
            found = checks.whole(f"Intrinsics.{name}", getattr(self, name), SIZES, ObservationError)
            object.__setattr__(self, name, found)

    def backproject(self, u: np.ndarray, v: np.ndarray) -> Float[np.ndarray, "n 3"]:
        """Ray directions in the camera frame with z = 1, so that a direction times z-depth is the point."""
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones(np.shape(u))], axis=-1)

    def project(self, p_camera: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Pixel coordinates (u, v) of points in the camera frame; the caller sees to z > 0."""
        return p_camera[:, :2] / p_camera[:, 2:] * [self.fx, self.fy] + [self.cx, self.cy]


@dataclass(frozen=True)
class Frame:
    """One posed RGB-D image with instance masks."""

    name: str
    depth: Float[np.ndarray, "h w"]
    """z-depth in metres; 0 where there is none."""
    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]
    """Camera to world; camera axes are OpenCV's (x right, y down, z forward)."""
    instances: Int[np.ndarray, "h w"]
    """Instance id of every pixel; 0 where there is none."""
    color: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB."""

    def __post_init__(self) -> None:
        """Raises ObservationError where an image is none of numbers, or of another size than the intrinsics."""
        checks.text("the name of a frame", self.name, ObservationError)
        where = f"frame {self.name}"
        checks.instance(f"{where}: intrinsics", self.intrinsics, Intrinsics, ObservationError)
        for name, shape, kinds in _IMAGES:
            if (given := getattr(self, name)) is not None or name != "color":
                image = checks.array(
                    f"{where}: {name}", given, shape, ObservationError, kinds=kinds, finite=False
                )
                object.__setattr__(self, name, image)
        if self.instances.size and self.instances.max() > IDS.most:
            raise ObservationError(
                f"{where}: an instance id is above {IDS.most:g}; number the objects from 1 on"
            )
        check_colors(where, self.color)
        check_sizes(where, self.intrinsics, depth=self.depth, instance=self.instances)


_IMAGES: tuple[tuple[str, tuple[int | None, ...], str], ...] = (
    ("depth", (None, None), "fiu"),
    ("T_world_camera", (4, 4), "fiu"),
    ("instances", (None, None), "iu"),
    ("color", (None, None, 3), "u"),
)
"""Arrays of a frame, their shapes and types."""


def check_colors(where: str, color: np.ndarray | None) -> None:
    """Raise ObservationError where whole numbers are not of the 8 bits that all who draw take them for."""
    if color is not None and color.dtype != np.uint8:
        raise ObservationError(f"{where}: color is an array of {color.dtype}; its entries must be of 8 bits")


def check_sizes(where: str, intrinsics: Intrinsics, **images: np.ndarray | None) -> None:
    """Raise ObservationError where an image is of another size than the intrinsics are for."""
    width, height = intrinsics.width, intrinsics.height
    for label, image in images.items():
        if image is not None and image.shape[:2] != (height, width):
            raise ObservationError(
                f"{where}: the {label} image is {image.shape[1]}x{image.shape[0]} pixels but the "
                f"intrinsics are for {width}x{height}; resize one or scale the intrinsics"
            )


@dataclass(frozen=True)
class Instance:
    """An object that the masks name."""

    id: int
    """The value of its pixels in `Frame.instances`."""
    category: str

    def __post_init__(self) -> None:
        """Raises ObservationError where the id is no whole number above 0, or the category no text."""
        checks.text(f"the category of object {self.id}", self.category, ObservationError)
        checks.whole(f"the id of a {self.category}", self.id, IDS, ObservationError)


IDS = checks.Range(1, 2**24)
"""Of objects in masks, where 0 is none."""


@dataclass(frozen=True)
class Scan:
    """Everything a loader gives: the input of mapping."""

    name: str
    frames: "FrameSource"
    instances: tuple[Instance, ...]
    up_world: Float[np.ndarray, "3"]
    """Unit vector against gravity, in the world frame."""

    def __post_init__(self) -> None:
        """Raises ObservationError where it is no scan, two instances share an id, or `up_world` has no direction."""
        where = f"scan {checks.text('the name of a scan', self.name, ObservationError)}"
        checks.instance(f"{where}: frames", self.frames, FrameSource, ObservationError)
        object.__setattr__(
            self,
            "instances",
            checks.tuple_of(f"{where}: instances", self.instances, Instance, ObservationError),
        )
        ids = [each.id for each in self.instances]
        if repeated := sorted({i for i in ids if ids.count(i) > 1}):
            raise ObservationError(f"{where}: several instances have the id {repeated[0]}; give each its own")
        up = checks.direction(f"{where}: up_world", self.up_world, ObservationError)
        object.__setattr__(self, "up_world", up)


class FrameSource:
    """Frames read on demand: a scan may be larger than memory."""

    def __len__(self) -> int:
        raise NotImplementedError

    def __getitem__(self, index: int) -> Frame:
        raise NotImplementedError

    @property
    def names(self) -> tuple[str, ...]:
        """Of all frames; this reads every one, a source that knows them without says so."""
        return tuple(self[i].name for i in range(len(self)))


class ListedFrames(FrameSource):
    """Frames that are in memory."""

    def __init__(self, frames: Sequence[Frame]) -> None:
        """Raises ObservationError where they are no list; what is no frame is named as it is read (`frame_of`)."""
        self._frames = checks.tuple_of("frames", frames, object, ObservationError)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        frame: Any = self._frames[index]
        return frame


def frame_of(frames: FrameSource, index: int) -> Frame:
    """One of a source; raises ObservationError where the source gives something else."""
    return checks.instance(f"frame {index} of the scan", frames[index], Frame, ObservationError)
