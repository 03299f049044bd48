"""What the factors of one view upon one object have in common."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import gtsam
import numpy as np
import torch
from torch import Tensor

from factors.decoder import Decoder, SdfJet
from factors.errors import FactorError
from factors.reduce import Rows, guarded_factor, reduce_rows
from factors.sdf import SdfQuery, query_points
from factors.state import CAMERA_DOF, POSE_DOF, SCALE_DOF, ObjectKeys, ObjectState


@dataclass(frozen=True)
class Annealing:
    """What is softened while an estimate is still far away."""

    slope: float = 400.0
    """Slope of the occupancy sigmoid, 1/metres (paper eq:sloped_sigmoid: l = 400)."""


@dataclass
class _Decoded:
    """The decoder's last answer to a factor, and what was asked."""

    fingerprint: bytes
    value: Tensor
    jet: SdfJet | None


class ObservationFactor(ABC):
    """A loss over one object's state and one camera, as a GTSAM factor of a few square-root rows.

    What must not change while a quadratic is being minimised (noise, sample depths) is frozen by `refresh`,
    and by the first evaluation where nobody called it. Loss and gradient are exact for the frozen quantities;
    the curvature is a positive semi-definite majoriser's.
    """

    def __init__(self, keys: ObjectKeys, decoder: Decoder, camera: gtsam.Pose3 | int) -> None:
        self.object_keys = keys
        self.decoder = decoder
        self.camera = camera
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
                f"{gtsam.DefaultKeyFormatter(self.object_keys.code)} holds a code of length "
                f"{len(state.code)}, but the decoder takes {self.decoder.code_length}"
            )
        return state

    def T_world_camera(self, values: gtsam.Values) -> gtsam.Pose3:
        return values.atPose3(self.camera) if isinstance(self.camera, int) else self.camera

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
    def loss_of(self, value: Tensor) -> float:
        """The frozen loss, given the decoder's values at `points_camera`."""

    @abstractmethod
    def rows_of(self, query: SdfQuery, jet: SdfJet) -> Rows:
        """Loss, residual rows and their Jacobian."""

    def query(self, values: gtsam.Values) -> SdfQuery:
        """What this factor asks of the decoder at `values`; freezes there first if nobody has."""
        if not self.is_frozen:
            self.refresh(values)
        state, camera = self.state(values), self.T_world_camera(values)
        return query_points(self.decoder, state, camera, self.points_camera())

    def loss(self, values: gtsam.Values) -> float:
        """The frozen loss: half the squared norm of the residual that GTSAM sees."""
        return self.loss_of(self._value(self.query(values)))

    def rows(self, values: gtsam.Values) -> Rows:
        """All rows, before their reduction."""
        query = self.query(values)
        return self.rows_of(query, self._jet(query))

    def remember(self, query: SdfQuery, value: Tensor, jet: SdfJet | None) -> None:
        """Keep the decoder's answer to `query`: the next evaluation at the same place need not ask again."""
        self._decoded = _Decoded(_fingerprint(query), value, jet)

    def knows(self, query: SdfQuery, jacobian: bool) -> bool:
        """Whether the answer to `query` is at hand."""
        last = self._decoded
        if last is None or (jacobian and last.jet is None):
            return False
        return last.fingerprint == _fingerprint(query)

    def gtsam_factor(self) -> gtsam.CustomFactor:
        """The factor to add to a graph; it follows later calls of `refresh` on this object."""
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
        if not self.knows(query, jacobian=False):
            with torch.no_grad():
                self.remember(query, self.decoder(query.p_object, query.code[None]), None)
        assert self._decoded is not None
        return self._decoded.value

    def _jet(self, query: SdfQuery) -> SdfJet:
        if not self.knows(query, jacobian=True):
            jet = self.decoder.linearize(query.p_object, query.code[None])
            self.remember(query, jet.value, jet)
        assert self._decoded is not None
        assert self._decoded.jet is not None
        return self._decoded.jet


def _fingerprint(query: SdfQuery) -> bytes:
    state = query.state
    parts = (query.p_object.cpu().numpy(), state.log_scale, state.code, state.T_world_object.matrix())
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
