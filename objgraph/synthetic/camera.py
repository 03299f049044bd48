"""A hand-held camera that walks about the middle of the room and looks at the furniture."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from objgraph.geometry.frames import look_at
from objgraph.observation.frames import Intrinsics

Pose = Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class CameraConfig:
    """The path and the pinhole camera."""

    frames: int = 28
    """Number of frames."""
    width: int = 320
    """Pixels."""
    height: int = 240
    """Pixels."""
    focal_per_width: float = 0.903
    """Focal length in image widths; that of ScanNet's depth camera."""
    radius_m: float = 2.1
    """Distance of the path from the room's middle."""
    height_m: float = 1.45
    """Mean height of the camera above the floor."""
    sweep_rad: float = 4.2
    """Angle that the path covers, centred on the room's -y side."""
    jitter_m: float = 0.03
    """Standard deviation of the hand's motion."""


def camera_matrix(config: CameraConfig) -> Float[np.ndarray, "3 3"]:
    """Intrinsics with pixel centres at integer coordinates."""
    f = config.focal_per_width * config.width
    return np.array([[f, 0, (config.width - 1) / 2], [0, f, (config.height - 1) / 2], [0, 0, 1.0]])


def intrinsics(config: CameraConfig | None = None) -> Intrinsics:
    """The same pinhole, of its images' size."""
    config = config or CameraConfig()
    K = camera_matrix(config)
    return Intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2], config.width, config.height)


def camera_path(
    config: CameraConfig, targets: Float[np.ndarray, "n 3"], rng: np.random.Generator
) -> list[Float[np.ndarray, "4 4"]]:
    """T_world_camera of every frame, OpenCV axes; the gaze wanders from object to object over the path."""
    n = config.frames
    bearing = -np.pi / 2 + config.sweep_rad * np.linspace(-0.5, 0.5, n)
    radius = config.radius_m * (1 + 0.08 * np.sin(np.linspace(0, 3 * np.pi, n)))
    eyes = np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing), np.full(n, config.height_m)])
    eyes += _shake(n, config.jitter_m, rng)
    gaze = _wander(targets, n, rng) + _shake(n, config.jitter_m, rng)
    roll = _shake(n, 0.02, rng)[:, 0]
    return [_rolled(eye, at, angle) for eye, at, angle in zip(eyes, gaze, roll, strict=True)]


def _wander(targets: Float[np.ndarray, "n 3"], frames: int, rng: np.random.Generator) -> np.ndarray:
    """A smooth path between the middle of all targets and each of them in turn."""
    order = rng.permutation(len(targets))
    visited = targets[order[np.arange(frames) * len(targets) // frames]]
    smooth = gaussian_filter1d(visited, frames / (2 * len(targets)), axis=0, mode="nearest")
    return 0.5 * smooth + 0.5 * targets.mean(axis=0)


def _shake(frames: int, sigma: float, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    return sigma * gaussian_filter1d(rng.normal(size=(frames, 3)), 1.0, axis=0, mode="nearest") * 1.9


def _rolled(eye: np.ndarray, at: np.ndarray, roll: float) -> Float[np.ndarray, "4 4"]:
    T = look_at(eye, at, np.array([0.0, 0.0, 1.0]))
    right, down = T[:3, 0].copy(), T[:3, 1].copy()
    T[:3, 0] = np.cos(roll) * right + np.sin(roll) * down
    T[:3, 1] = np.cos(roll) * down - np.sin(roll) * right
    return T
