"""What the sensor says about an object: frames, masks, and the points and rays sampled from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from objgraph.errors import ObservationError


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion; pixel centres lie at integer coordinates."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

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
        shape = (self.intrinsics.height, self.intrinsics.width)
        for label, image in (("depth", self.depth), ("instance", self.instances)):
            if image.shape[:2] != shape:
                raise ObservationError(
                    f"frame {self.name}: the {label} image is {image.shape[1]}x{image.shape[0]} pixels but the "
                    f"intrinsics are for {shape[1]}x{shape[0]}; resize one or scale the intrinsics"
                )


@dataclass(frozen=True)
class Instance:
    """An object that the masks name."""

    id: int
    """The value of its pixels in `Frame.instances`."""
    category: str


@dataclass(frozen=True)
class Scan:
    """Everything a loader gives: the input of mapping."""

    name: str
    frames: "FrameSource"
    instances: tuple[Instance, ...]
    up_world: Float[np.ndarray, "3"]
    """Unit vector against gravity, in the world frame."""


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
