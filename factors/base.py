"""What the factors of one view upon one object have in common."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.errors import FactorError
from factors.keys import readable_key
from factors.reduce import Rows, guarded_factor, reduce_rows
from factors.sdf import SdfQuery, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import CAMERA_DOF, POSE_DOF, SCALE_DOF, ObjectKeys, ObjectState

SLOPES = checks.Range(1e-3, 1e6)
"""Of the occupancy, 1/metres: beyond them probabilities are all one half, or 0 and 1."""


@dataclass(frozen=True)
class Annealing:
    """What is softened while an estimate is still far away."""

    slope: float = 400.0
    """Slope of the occupancy sigmoid, 1/metres (paper eq:sloped_sigmoid: l = 400)."""

    def __post_init__(self) -> None:
        checks.settings(self, slope=SLOPES)


@dataclass
class _Decoded:
    """The decoder's last answers to a factor, and what was asked."""

    fingerprint: bytes
    value: Tensor
    jet: SdfJet | None = None


class ObservationFactor(ABC):
    """A loss over one object's state and one camera, as a GTSAM factor of a few square-root rows.

    What must not change while a quadratic is being minimised (noise, sample depths) is frozen by `refresh`,
    and by the first evaluation where nobody called it. Loss and gradient are exact for the frozen quantities;
    the curvature is positive semi-definite: a majoriser's of the 3D factor and of Gaussian depths, Gauss-Newton's of the full
    distribution over depth.

    `camera` is T_world_camera, or the key of a `Pose3` that holds it. With `body_T_camera` it is the pose of a body
    on which the camera is fixed: T_world_camera = T_world_body * body_T_camera.

    Its answers are kept, so that the decoder's weights must not change while factors hold it.
    The decoder may be on another device: it is asked there, its answers come to the CPU, where GTSAM and all else is.
    """

    def __init__(
        self,
        keys: ObjectKeys,
        decoder: SdfDecoder,
        camera: gtsam.Pose3 | int,
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> None:
        """Raises FactorError where one of them is of another kind, or a pose is not finite."""
        name = type(self).__name__
        self.object_keys = checks.instance(f"{name}: keys", keys, ObjectKeys)
        self.decoder = checks.instance(f"{name}: decoder", decoder, SdfDecoder)
        self.camera = (
            checks.pose(f"{name}: camera", camera)
            if isinstance(camera, gtsam.Pose3)
            else checks.key(f"{name}: camera (a Pose3 or a key)", camera)
        )
        if isinstance(self.camera, int) and self.camera in tuple(self.object_keys):
            raise FactorError(
                f"{name}: {readable_key(self.camera)} is the object's own: the camera needs another key"
            )
        self.body_T_camera = (
            None if body_T_camera is None else checks.pose(f"{name}: body_T_camera", body_T_camera)
        )
        self._decoded: _Decoded | None = None

    @property
    def has_camera_key(self) -> bool:
        return isinstance(self.camera, int)

    @property
    def keys(self) -> list[int]:
        """GTSAM keys in the order of the Jacobian's columns: pose, log-scale, code (, camera)."""
        return [*self.object_keys, self.camera] if isinstance(self.camera, int) else list(self.object_keys)

    @property
    def dims(self) -> list[int]:
        """Tangent dimension of each key."""
        dims = [POSE_DOF, SCALE_DOF, self.decoder.code_length]
        return [*dims, CAMERA_DOF] if self.has_camera_key else dims

    def state(self, values: gtsam.Values) -> ObjectState:
        """The object's state; raises FactorError where its code does not fit the decoder."""
        state = ObjectState.from_values(values, self.object_keys)
        if len(state.code) != self.decoder.code_length:
            raise FactorError(
                f"{readable_key(self.object_keys.code)} holds a code of length "
                f"{len(state.code)}, but the decoder takes {self.decoder.code_length}"
            )
        return state

    def T_world_camera(self, values: gtsam.Values) -> gtsam.Pose3:
        """Raises FactorError where the camera's key holds no pose."""
        try:
            pose = values.atPose3(self.camera) if isinstance(self.camera, int) else self.camera
        except RuntimeError as error:
            name = readable_key(self.keys[-1])
            raise FactorError(f"the values hold no camera at {name}: {str(error).strip()}") from error
        return pose if self.body_T_camera is None else pose.compose(self.body_T_camera)

    @abstractmethod
    def refresh(self, values: gtsam.Values, annealing: Annealing = Annealing()) -> None:
        """Freeze at `values` what must not change while a quadratic is being minimised."""

    @property
    @abstractmethod
    def is_frozen(self) -> bool:
        """Whether `refresh` has been called."""

    @abstractmethod
    def points_camera(self) -> np.ndarray:
        """The camera-frame points (n, 3) to decode."""

    @abstractmethod
    def loss_of(self, query: SdfQuery, value: Tensor) -> float:
        """The frozen loss, given the decoder's values at `points_camera`."""

    @abstractmethod
    def active(self, query: SdfQuery, value: Tensor) -> Tensor:
        """Indices of the points whose derivatives matter, given the decoder's values at all of them."""

    @abstractmethod
    def rows_of(self, query: SdfQuery, value: Tensor, jet: SdfJet) -> Rows:
        """Loss, residual rows and their Jacobian, given all values and the active points' derivatives."""

    def sdf_jacobian(self, query: SdfQuery, jet: SdfJet) -> Float[Tensor, "n d"]:
        """Derivative of the canonical SDF w.r.t. the factor's variables, in the order of `keys`."""
        jacobian = sdf_jacobian(query, jet, self.has_camera_key)
        if self.has_camera_key and self.body_T_camera is not None:
            # the camera's tangent is the body's, seen from the camera
            carried = torch.as_tensor(self.body_T_camera.inverse().AdjointMap()).to(jacobian)
            jacobian[:, -CAMERA_DOF:] = jacobian[:, -CAMERA_DOF:] @ carried
        return jacobian

    def query(self, values: gtsam.Values) -> SdfQuery:
        """What this factor asks of the decoder at `values`; freezes there first if nobody has."""
        if not self.is_frozen:
            self.refresh(values)
        state, camera = self.state(values), self.T_world_camera(values)
        return query_points(self.decoder, state, camera, self.points_camera())

    def loss(self, values: gtsam.Values) -> float:
        """The frozen loss: half the squared norm of the residual that GTSAM sees."""
        query = self.query(values)
        return self.loss_of(query, self._value(query))

    def rows(self, values: gtsam.Values) -> Rows:
        """All rows, before their reduction."""
        query = self.query(values)
        value, jet = self._value(query), self._jet(query)
        return self.rows_of(query, value, jet)

    def known_value(self, query: SdfQuery) -> Tensor | None:
        """The decoder's values at `query`, where they are at hand."""
        last = self._decoded
        return last.value if last is not None and last.fingerprint == query.fingerprint else None

    def known_jet(self, query: SdfQuery) -> SdfJet | None:
        """The active points' derivatives at `query`, where they are at hand."""
        last = self._decoded
        return last.jet if last is not None and last.fingerprint == query.fingerprint else None

    def remember(self, query: SdfQuery, value: Tensor, jet: SdfJet | None = None) -> None:
        """Keep the decoder's answers to `query`, unless they are not finite: the same place need not ask again."""
        self._decoded = _Decoded(query.fingerprint, value, jet) if value.isfinite().all() else None

    def gtsam_factor(self) -> gtsam.CustomFactor:
        """The factor to add to a graph; it follows later calls of `refresh` on this object.

        It is Python's: GTSAM can neither clone nor serialise it, and so not use it in GNC; `linearized` gives a factor
        that can be.
        """
        dims = self.dims
        splits = np.cumsum(dims)[:-1]

        def evaluate(values: gtsam.Values, jacobian: bool):
            if not jacobian:
                residual = np.zeros(sum(dims) + 1)
                residual[-1] = np.sqrt(2.0 * self.loss(values))
                return residual, None
            reduced = reduce_rows(self.rows(values))
            return reduced.residual, np.split(reduced.jacobian, splits, axis=1)

        return guarded_factor(self.keys, dims, sum(dims) + 1, evaluate, type(self).__name__)

    def _value(self, query: SdfQuery) -> Tensor:
        value = self.known_value(query)
        if value is None:
            with torch.no_grad():
                value = self.decoder(query.p_object, query.code[None]).cpu()
            self.remember(query, value)
        return value

    def _jet(self, query: SdfQuery) -> SdfJet:
        jet = self.known_jet(query)
        if jet is None:
            value = self._value(query)
            some = query.take(self.active(query, value))
            jet = self.decoder.linearize(some.p_object, query.code[None]).cpu()
            self.remember(query, value, jet)
        return jet


def place_of(state: ObjectState, T_world_camera: gtsam.Pose3, annealing: Annealing) -> bytes:
    """Equal where `refresh` would freeze the same: it is asked for at the same place again and again."""
    parts = (
        state.T_world_object.matrix(),
        state.log_scale,
        state.code,
        T_world_camera.matrix(),
        annealing.slope,
    )
    return b"".join(np.asarray(part, dtype=float).tobytes() for part in parts)
