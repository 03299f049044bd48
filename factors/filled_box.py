"""The filled-box factor: a shape of a prior whose shapes all have one bounding box touches its six sides."""

from typing import NamedTuple

import gtsam
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from factors import checks
from factors.base import Annealing, ObservationFactor
from factors.checks import DEVIATIONS
from factors.errors import FactorError
from factors.reduce import Rows
from factors.score import cauchy_root, cauchy_score
from factors.sdf import SdfQuery, query_points
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import RIGID_DOF, ObjectKeys, ObjectState

SIDES = 6
_ACROSS = 24
"""Places a side along each of its edges where the surface is looked for."""
_NEAREST = 32
"""Of them, those nearest to the surface, among which the nearest is found anew as the code changes."""
_TAIL = 3.0
"""Standard deviations beyond which a side is taken less and less to be touched."""


class _Nearest(NamedTuple):
    value: Float[Tensor, "6"]
    index: Int[Tensor, "6"]
    """Among all points of the query."""


class FilledBoxFactor(ObservationFactor):
    """Scores of the least signed distance on each side of the box: 0 where the surface touches it and does not cross it.

    Says what shape and scale together do not: the box of every training shape is the prior's, so that the scale alone
    is the object's size. It says nothing of pose and scale. Scores are Cauchy's: what no code can do is let go.

    Frozen by `refresh`: the places next to the surface.
    """

    def __init__(
        self, keys: ObjectKeys, decoder: SdfDecoder, box: Float[np.ndarray, "3"], sigma: float
    ) -> None:
        """`box` has the canonical edges, `sigma` is the standard deviation of the decoder's signed distance there.

        Raises:
            FactorError: an edge or the standard deviation is not positive.
        """
        super().__init__(keys, decoder, gtsam.Pose3())
        self._sides = _sides(checks.reals("a box's edges", box, (3,), DEVIATIONS) / 2)
        self._sigma = checks.number("a box's standard deviation", sigma, DEVIATIONS)
        self._p_object: Float[np.ndarray, "n 3"] | None = None
        self._frozen_at: bytes | None = None

    @property
    def is_frozen(self) -> bool:
        return self._p_object is not None

    def refresh(self, values: gtsam.Values, annealing: Annealing = Annealing()) -> None:  # noqa: B008
        if (place := self.state(values).code.tobytes()) == self._frozen_at:
            return
        query = self._query(values, self._sides.reshape(-1, 3))
        with torch.no_grad():
            distance = self.decoder(query.p_object, query.code[None]).reshape(SIDES, -1)
        nearest = distance.topk(_NEAREST, dim=1, largest=False).indices.cpu().numpy()
        self._p_object = np.take_along_axis(self._sides, nearest[:, :, None], axis=1).reshape(-1, 3)
        self._frozen_at = place if distance.isfinite().all() else None

    def points_camera(self) -> np.ndarray:
        """In the object's canonical frame: the camera is the object's own."""
        if self._p_object is None:
            raise FactorError("a FilledBoxFactor must be refreshed before its parts are evaluated")
        return self._p_object

    def T_world_camera(self, values: gtsam.Values) -> gtsam.Pose3:
        """Where the object is: it may be moved as a whole."""
        return self.state(values).T_world_object

    def query(self, values: gtsam.Values) -> SdfQuery:
        if not self.is_frozen:
            self.refresh(values)
        return self._query(values, self.points_camera())

    def loss_of(self, query: SdfQuery, value: Tensor) -> float:
        return float(cauchy_score(self._nearest(value).value / self._sigma, _TAIL).sum())

    def active(self, query: SdfQuery, value: Tensor) -> Tensor:
        return self._nearest(value).index

    def sdf_jacobian(self, query: SdfQuery, jet: SdfJet) -> Float[Tensor, "n d"]:
        return torch.cat([jet.d_code.new_zeros(len(jet.d_code), RIGID_DOF), jet.d_code], dim=1)

    def rows_of(self, query: SdfQuery, value: Tensor, jet: SdfJet) -> Rows:
        r = self._nearest(value).value / self._sigma
        root = cauchy_root(r, _TAIL)
        jacobian = root[:, None] * self.sdf_jacobian(query, jet).double() / self._sigma
        return Rows(jacobian, root * r, float(cauchy_score(r, _TAIL).sum()))

    def _nearest(self, value: Tensor) -> _Nearest:
        least = value.double().reshape(SIDES, -1).min(dim=1)
        first = torch.arange(SIDES, device=value.device) * (len(value) // SIDES)
        return _Nearest(least.values, first + least.indices)

    def _query(self, values: gtsam.Values, p_object: Float[np.ndarray, "n 3"]) -> SdfQuery:
        canonical = ObjectState(gtsam.Pose3(), np.zeros(3), self.state(values).code)
        return query_points(self.decoder, canonical, gtsam.Pose3(), p_object)


def _sides(half: Float[np.ndarray, "3"]) -> Float[np.ndarray, "6 n 3"]:
    """Points on the sides at -x, +x, -y, +y, -z, +z, evenly spread."""
    across = (np.arange(_ACROSS) + 0.5) / _ACROSS * 2.0 - 1.0
    u, v = (axis.ravel() for axis in np.meshgrid(across, across, indexing="ij"))
    sides = [
        np.insert(np.column_stack([u, v]), axis, sign, axis=1) for axis in range(3) for sign in (-1.0, 1.0)
    ]
    return np.stack(sides) * half
