"""What the variable behind a GTSAM key is."""

from collections.abc import Iterable
from enum import Enum

import gtsam

from factors.keys import readable_key
from factors.state import CAMERA_DOF, ObjectKeys


class Role(Enum):
    """What a variable is to the back-end."""

    OBJECT_POSE = "object pose"
    LOG_SCALE = "log-scale"
    CODE = "code"
    CAMERA = "camera"
    """Any `Pose3` that is no object's."""
    POINT = "point"
    VELOCITY = "velocity"
    """In the world's axes, as GTSAM's IMU factors have it: three numbers, as a point's."""
    OTHER = "other"


def roles(dims: dict[int, int], values: gtsam.Values, objects: Iterable[ObjectKeys] = ()) -> dict[int, Role]:
    """The role of every key of `dims` (tangent dimensions).

    The keys of `objects` have theirs; of others the default letters o, s, z and v and the variable's type decide.
    """
    known: dict[int, Role] = {}
    for keys in objects:
        known |= {keys.pose: Role.OBJECT_POSE, keys.log_scale: Role.LOG_SCALE, keys.code: Role.CODE}
    return {key: known.get(key) or _guess(key, dim, values) for key, dim in dims.items()}


def is_pose(key: int, values: gtsam.Values) -> bool:
    """Whether `values` holds a `Pose3` under `key`."""
    try:
        values.atPose3(key)
    except RuntimeError:  # a variable of another type, or none
        return False
    return True


def _guess(key: int, dim: int, values: gtsam.Values) -> Role:
    letter = readable_key(key)[0]
    if dim == CAMERA_DOF and is_pose(key, values):
        return Role.OBJECT_POSE if letter == "o" else Role.CAMERA
    if letter == "z":
        return Role.CODE
    if dim == 3 and values.exists(key):
        return Role.LOG_SCALE if letter == "s" else _vector(key, letter, values)
    return Role.OTHER


def _vector(key: int, letter: str, values: gtsam.Values) -> Role:
    try:
        values.atPoint3(key)
    except RuntimeError:  # three unknowns of another kind: a Pose2, a Rot3
        return Role.OTHER
    return Role.VELOCITY if letter == "v" else Role.POINT
