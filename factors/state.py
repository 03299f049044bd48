"""An object's state (pose, log-scale, shape code) and where it lives in a `gtsam.Values`."""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import O, S, Z
from jaxtyping import Float

from factors import checks
from factors.errors import FactorError
from factors.keys import readable_key

POSE_DOF = 6
SCALE_DOF = 3
CAMERA_DOF = 6
RIGID_DOF = POSE_DOF + SCALE_DOF
"""Size of the 9-DoF block: rotation, translation, log-scale."""
LOG_SCALES = checks.Range(-14.0, 14.0)
"""Of what an estimate may begin at: from micrometres to a thousand kilometres."""


@dataclass(frozen=True)
class ObjectKeys:
    """The three GTSAM keys of one object."""

    pose: int
    """`Pose3`, T_world_object."""
    log_scale: int
    """`Vector(3)`, logarithm of the metres per canonical unit along the object's own axes."""
    code: int
    """`Vector(l)`, the shape code."""

    def __post_init__(self) -> None:
        """Raises FactorError where one is no key, or two are the same."""
        for name, key in list(vars(self).items()):
            object.__setattr__(self, name, checks.key(f"ObjectKeys.{name}", key))
        if len(set(self)) < len(vars(self)):
            names = ", ".join(readable_key(key) for key in self)
            raise FactorError(f"the keys of an object must be three different ones, not {names}")

    @classmethod
    def numbered(cls, index: int) -> "ObjectKeys":
        """The default keys o{index}, s{index}, z{index}."""
        index = checks.whole("the number of an object", index, checks.Range(0, 2**48))
        return cls(O(index), S(index), Z(index))

    def __iter__(self):
        return iter((self.pose, self.log_scale, self.code))


@dataclass(frozen=True)
class ObjectState:
    """Pose, scale and shape of one object; `p_world = T_world_object (exp(log_scale) * p_object)`.

    This is the paper's 9-DoF pose (eq:9dof) read object-to-world, with the scale along the object's axes.
    """

    T_world_object: gtsam.Pose3
    log_scale: Float[np.ndarray, "3"]
    code: Float[np.ndarray, "l"]

    def __post_init__(self) -> None:
        """Raises FactorError where one of them is of another kind or shape; they need not be finite (`check_finite`)."""
        checks.instance("ObjectState.T_world_object", self.T_world_object, gtsam.Pose3)
        for name, shape in (("log_scale", (3,)), ("code", (None,))):
            found = checks.array(f"ObjectState.{name}", getattr(self, name), shape, finite=False)
            object.__setattr__(self, name, found.astype(float))

    @classmethod
    def from_values(cls, values: gtsam.Values, keys: ObjectKeys) -> "ObjectState":
        """Raises FactorError where one of the keys is not in the values, or is of something else."""
        try:
            return cls(values.atPose3(keys.pose), values.atVector(keys.log_scale), values.atVector(keys.code))
        except (RuntimeError, FactorError) as error:  # another kind of value, or another shape
            names = ", ".join(readable_key(key) for key in keys)
            raise FactorError(f"the values hold no object at {names}: {str(error).strip()}") from error

    def check_finite(self, keys: ObjectKeys) -> None:
        """Raise FactorError naming the key of what is not finite, or of a scale that no object has."""
        checks.pose(f"{readable_key(keys.pose)}, T_world_object,", self.T_world_object)
        checks.reals(f"{readable_key(keys.log_scale)}, the log-scale,", self.log_scale, (3,), LOG_SCALES)
        checks.reals(f"{readable_key(keys.code)}, the code,", self.code, (None,))

    def insert(self, values: gtsam.Values, keys: ObjectKeys) -> None:
        """Add this state to `values`; raises FactorError naming the key if one is taken."""
        for key in keys:
            if values.exists(key):
                raise FactorError(f"the key {readable_key(key)} is already in the values")
        values.insert(keys.pose, self.T_world_object)
        values.insert(keys.log_scale, self.log_scale)
        values.insert(keys.code, self.code)

    def update(self, values: gtsam.Values, keys: ObjectKeys) -> None:
        """Overwrite the state that `values` holds under `keys`."""
        values.update(keys.pose, self.T_world_object)
        values.update(keys.log_scale, self.log_scale)
        values.update(keys.code, self.code)

    def retract(self, delta: Float[np.ndarray, "9+l"]) -> "ObjectState":
        """Move along the tangent [rotation, translation, log-scale, code], pose in the body frame."""
        return replace(
            self,
            T_world_object=self.T_world_object.retract(delta[:POSE_DOF]),
            log_scale=self.log_scale + delta[POSE_DOF:RIGID_DOF],
            code=self.code + delta[RIGID_DOF:],
        )

    def local_coordinates(self, other: "ObjectState") -> Float[np.ndarray, "9+l"]:
        """The tangent along which `retract` leads from this state to the other."""
        pose = self.T_world_object.localCoordinates(other.T_world_object)
        return np.concatenate([pose, other.log_scale - self.log_scale, other.code - self.code])

    @property
    def scale(self) -> Float[np.ndarray, "3"]:
        """Metres per canonical unit along the object's axes."""
        return np.exp(self.log_scale)

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """T·R·S as one matrix: homogeneous canonical object coordinates to world coordinates."""
        matrix = self.T_world_object.matrix().copy()
        matrix[:3, :3] *= self.scale
        return matrix

    @property
    def xi_world_object(self) -> Float[np.ndarray, "9"]:
        """[t, phi, s] of T_world_object, in the order of paper eq:9dof_lie_algebra."""
        rotation = gtsam.Rot3.Logmap(self.T_world_object.rotation())
        return np.concatenate([self.T_world_object.translation(), rotation, self.scale])

    def to_object(self, p_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Canonical object coordinates of world points: exp(-s) * R^T (p_world - t)."""
        R_world_object = self.T_world_object.rotation().matrix()
        return (p_world - self.T_world_object.translation()) @ R_world_object / self.scale

    def to_world(self, p_object: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """World coordinates of canonical object points."""
        R_world_object = self.T_world_object.rotation().matrix()
        return (p_object * self.scale) @ R_world_object.T + self.T_world_object.translation()
