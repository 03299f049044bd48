"""What odometry says of a new camera: where it is, how surely, and the factors that say so."""

from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.odometry import OdometryNoise


@dataclass(frozen=True)
class Motion:
    """From the last camera of the map to the new one."""

    odometry: gtsam.Pose3
    """The odometry's own pose of the new camera."""
    predicted: gtsam.Pose3
    """T_world_camera of the new camera in the map."""
    factors: tuple[gtsam.NonlinearFactor, ...] = ()
    """What says so."""
    known: tuple[int, ...] = ()
    """The last camera's key; empty for the first frame, and the new camera's where the map has it already."""
    T_previous_current: gtsam.Pose3 | None = None
    covariance: Float[np.ndarray, "6 6"] | None = None
    """Of the motion, in the new camera's frame."""

    def with_camera(self, joint: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
        """The joint covariance with the last camera, whose 6 are the last rows, becomes that with the new camera."""
        if self.T_previous_current is None or self.covariance is None:
            return joint
        carry = np.eye(len(joint))
        carry[-6:, -6:] = self.T_previous_current.inverse().AdjointMap()
        moved = carry @ joint @ carry.T
        moved[-6:, -6:] += self.covariance
        return moved


def anchored(camera: int, odometry: gtsam.Pose3, config: IncrementalConfig) -> Motion:
    """The first camera: the map begins where the odometry does."""
    sigmas = np.repeat([config.anchor_rotation, config.anchor_translation], 3)
    factor = gtsam.PriorFactorPose3(camera, odometry, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
    return Motion(odometry, odometry, (factor,))


def moved(
    previous: int,
    camera: int,
    T_world_previous: gtsam.Pose3,
    before: gtsam.Pose3,
    now: gtsam.Pose3,
    noise: OdometryNoise,
) -> Motion:
    """A further camera: `before` and `now` are the odometry's poses, `T_world_previous` the map's."""
    T_previous_current = before.between(now)
    model = noise.model(T_previous_current)
    factor = gtsam.BetweenFactorPose3(previous, camera, T_previous_current, model)
    predicted = T_world_previous.compose(T_previous_current)
    return Motion(now, predicted, (factor,), (previous,), T_previous_current, np.diag(model.sigmas() ** 2))


def known_already(camera: int, T_world_camera: gtsam.Pose3) -> Motion:
    """A camera that the map has: nothing is to be said of its motion."""
    return Motion(T_world_camera, T_world_camera, (), (camera,), gtsam.Pose3(), np.zeros((6, 6)))


def joint_with_last_camera(
    own: Float[np.ndarray, "d d"], T_object_first: gtsam.Pose3, cameras: Float[np.ndarray, "c c"]
) -> Float[np.ndarray, "d+6 d+6"]:
    """Joint covariance of an object and the last camera, where `own` is the object's as seen from an earlier, first one.

    `cameras` is that of the first and the last camera, of 6 rows where they are the same; the first's error moves the object
    rigidly with it. The object's pose comes first in `own`; all poses are in the body frame.
    """
    carry = np.zeros((len(own) + 6, len(cameras)))
    carry[:6, :6], carry[-6:, -6:] = T_object_first.AdjointMap(), np.eye(6)
    return np.asarray(block_diag(own, np.zeros((6, 6))) + carry @ cameras @ carry.T)
