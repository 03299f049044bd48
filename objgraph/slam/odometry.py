"""How odometry errs: the noise of one motion, and trajectories that drift by it."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from factors import checks
from factors.checks import DEVIATIONS
from objgraph.errors import ConfigError


@dataclass(frozen=True)
class OdometryNoise:
    """How far off the motion between two frames may be, standard deviations about and along each axis."""

    translation: float = 0.02
    """Share of the distance moved."""
    rotation: float = np.radians(1.0)
    """Radians a metre moved."""
    turning: float = 0.02
    """Share of the angle turned."""
    least_translation: float = 0.002
    """Metres, of a camera that stands still."""
    least_rotation: float = 0.001
    """Radians, of a camera that stands still."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is negative, or a camera that stands still is said to err not at all."""
        checks.settings(self, ConfigError, least_translation=DEVIATIONS, least_rotation=DEVIATIONS)

    def model(self, T_previous_current: gtsam.Pose3) -> gtsam.noiseModel.Base:
        """The noise of one motion, in the current camera's frame."""
        distance = float(np.linalg.norm(T_previous_current.translation()))
        angle = float(np.linalg.norm(gtsam.Rot3.Logmap(T_previous_current.rotation())))
        rotation = np.linalg.norm([self.rotation * distance, self.turning * angle, self.least_rotation])
        translation = np.hypot(self.translation * distance, self.least_translation)
        return gtsam.noiseModel.Diagonal.Sigmas(np.repeat([rotation, translation], 3))


def drifting_motions(
    T_world_cameras: Sequence[gtsam.Pose3], noise: OdometryNoise, rng: np.random.Generator
) -> list[gtsam.Pose3]:
    """What such odometry measures from each camera to the next (T_previous_current)."""
    motions = [before.between(after) for before, after in itertools.pairwise(T_world_cameras)]
    return [motion.retract(noise.model(motion).sigmas() * rng.normal(size=6)) for motion in motions]


def dead_reckoning(start: gtsam.Pose3, motions: Sequence[gtsam.Pose3]) -> list[gtsam.Pose3]:
    """T_world_camera of every camera if motions were all that is known."""
    return list(itertools.accumulate(motions, gtsam.Pose3.compose, initial=start))
