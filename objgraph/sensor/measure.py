"""Noise of depth by range and accuracy of camera poses, from pairs of frames that see the same."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from objgraph.errors import ConfigError, DatasetError
from objgraph.observation.frames import FrameSource
from objgraph.observation.sampling import SamplingConfig, SensorNoise, rigid_pose
from objgraph.sensor.depth_noise import fitted_noise, patch_offsets
from objgraph.sensor.registration import (
    MAX_DEPTH,
    OVERLAP,
    Cloud,
    Pair,
    cloud_of,
    parts,
    registered,
    together,
)

_CHI_3 = 1.5382
"""Median length of a vector of three standard normal variables."""
_ENOUGH_PAIRS, _ENOUGH_PATCHES = 5, 100
_LEAST = 1e-4
"""Radians and metres: no pose is known better."""


@dataclass(frozen=True)
class SensorConfig:
    """How much is looked at."""

    frames: int = 24
    """Spread evenly over the scan."""
    pairs: int = 100
    """Of frames that overlap, at most."""
    seed: int = 0
    """Which, where there are more."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(self, ConfigError, frames=checks.Range(2, 1000), pairs=checks.Range(1))


@dataclass(frozen=True)
class Sensor:
    """What was measured."""

    noise: SensorNoise
    """By which a patch of surface is off in one depth image."""
    pose_sigma: tuple[float, float]
    """Radians and metres, about and along each axis, by which the scan's camera poses are off."""
    pairs: int
    """Frames that were registered with each other."""
    patches: int
    """Planes that both frames of a pair see."""

    def settings(self) -> dict[str, dict[str, object]]:
        """Of `MappingConfig`: what `objgraph map --config` takes.

        Noise is no smaller than the default, which stands for what else is off in a patch, too: the prior, the mask.
        """
        usual = SensorNoise()
        noise = {
            "base": max(self.noise.base, usual.base),
            "quadratic": max(self.noise.quadratic, usual.quadratic),
        }
        return {"sampling": {"noise": noise}, "graph": {"pose_sigma": list(self.pose_sigma)}}


def measure_sensor(
    frames: FrameSource,
    config: SensorConfig | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Sensor:
    """Register frames that overlap, begin with their poses, and see what is left.

    Two frames' poses disagree with their registration by the errors of both; planes that both see are off from each other by
    the noise of both. The walls of a room suffice; objects and masks take no part.

    Raises:
        DatasetError: too few frames overlap, or too few planes are seen twice.
    """
    config = checks.settings_or_default(config, SensorConfig, ConfigError)
    tell = progress or (lambda what, done, total: None)
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(config.frames, len(frames))).astype(int))
    clouds, poses, close = [], [], []
    for k, index in enumerate(chosen):
        frame = frames[int(index)]
        known = np.isfinite(frame.depth) & (frame.depth > 0)
        close.append(frame.depth[known] < MAX_DEPTH)
        if (cloud := cloud_of(frame)) is not None:
            poses.append(rigid_pose(frame, f"frame {frame.name}").matrix())
            clouds.append(cloud)
        tell("reading frames", k + 1, len(chosen))
    how = "--frames" if len(chosen) < len(frames) else "these are all: record more"
    T_world_camera, pairs = np.reshape(poses, (-1, 4, 4)), []
    if clouds:
        clouds, T_world_camera, pairs = _connected(clouds, T_world_camera, config, tell)
    if len(pairs) < _ENOUGH_PAIRS:
        within = np.concatenate([np.zeros(0, bool), *close])
        raise DatasetError(
            f"{len(pairs)} pairs of {len(chosen)} frames overlap by {OVERLAP:.0%}, {_ENOUGH_PAIRS} are due: look at more frames "
            f"({how}), or from nearer: {within.mean() if len(within) else 0:.0%} of the depth is within {MAX_DEPTH} m, "
            "which alone counts"
        )
    offsets = np.concatenate(
        [patch_offsets(pair, clouds, SamplingConfig().correlation_length) for pair in pairs]
    )
    if len(offsets) < _ENOUGH_PATCHES:
        raise DatasetError(
            f"{len(offsets)} planes are seen by two frames, {_ENOUGH_PATCHES} are due: look at more frames ({how}), or scan walls and floor"
        )
    return Sensor(
        fitted_noise(offsets),
        _pose_sigma(T_world_camera, together(T_world_camera, clouds, pairs), pairs),
        len(pairs),
        len(offsets),
    )


def _connected(
    clouds: list[Cloud],
    T_world_camera: Float[np.ndarray, "n 4 4"],
    config: SensorConfig,
    tell: Callable[[str, int, int], None],
) -> tuple[list[Cloud], Float[np.ndarray, "m 4 4"], list[Pair]]:
    """Register frames in a random order, and take the largest part that is connected, its frames numbered anew."""
    count = len(clouds)
    candidates = [(i, j) for i in range(count) for j in range(i + 1, count)]
    pairs: list[Pair] = []
    for k, which in enumerate(np.random.default_rng(config.seed).permutation(len(candidates))):
        i, j = candidates[int(which)]
        pair = registered(i, j, clouds, T_world_camera)
        pairs += [] if pair is None else [pair]
        tell("registering frames", k + 1, len(candidates))
        if len(pairs) == config.pairs:
            break
    part = parts(count, pairs)
    kept = np.flatnonzero(part == np.bincount(part).argmax())
    number = {int(old): new for new, old in enumerate(kept)}
    inside = [Pair(number[p.i], number[p.j], p.T_j_i) for p in pairs if p.i in number]
    return [clouds[int(k)] for k in kept], T_world_camera[kept], inside


def _pose_sigma(
    given: Float[np.ndarray, "n 4 4"], joint: Float[np.ndarray, "n 4 4"], pairs: Sequence[Pair]
) -> tuple[float, float]:
    """Of one pose about and along each axis.

    A registration is off from the poses given by the errors of two, and its own; its own is what it is off from the poses that all
    registrations agree on.
    """
    variance = (_spread(given, pairs) ** 2 - _spread(joint, pairs) ** 2) / 2
    rotation, translation = np.sqrt(np.maximum(variance, _LEAST**2))
    return float(rotation), float(translation)


def _spread(poses: Float[np.ndarray, "n 4 4"], pairs: Sequence[Pair]) -> Float[np.ndarray, "2"]:
    """Deviation along each axis of the pairs from poses, radians and metres; by medians, as some registrations slide."""
    off = [gtsam.Pose3.Logmap(gtsam.Pose3(np.linalg.inv(poses[p.i]) @ poses[p.j] @ p.T_j_i)) for p in pairs]
    return np.median(np.linalg.norm(np.reshape(off, (-1, 2, 3)), axis=2), axis=0) / _CHI_3
