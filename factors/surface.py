"""The 3D factor: measured surface points lie where the object's SDF is zero (paper L_3D, equ:3d_loss)."""

from typing import NamedTuple

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.base import Annealing, ObservationFactor, place_of
from factors.checks import DEVIATIONS, LENGTHS, PLACES
from factors.errors import FactorError
from factors.reduce import Rows
from factors.score import (
    bounded_score,
    bounded_slope,
    energy_score,
    majorizing_weight,
    unit_information_weight,
)
from factors.sdf import MetricSdf, SdfQuery, propagated_variance, query_points, sdf_jacobian
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import RIGID_DOF, ObjectKeys


class _Frozen(NamedTuple):
    metric: MetricSdf
    sigma: Float[Tensor, "n"]
    weight: Float[Tensor, "n"]
    tail: float | None


class SurfaceFactor(ObservationFactor):
    """Energy scores of the SDF at the surface points of one view, in metres.

    Frozen by `refresh`: the decoder's gradient, by which metres follow the scale, and each point's standard deviation, which joins the
    sensor's, the prior's own error and, where `state_covariance` is given, the propagated one of
    paper eq:sdf_variance.

    With a `tail` each score is bounded (`bounded_score`): a point much farther off is of something else that the mask
    holds. While rays are soft the tail is longer, by the root of how much softer, so that what is off its place is found.
    """

    def __init__(
        self,
        keys: ObjectKeys,
        decoder: SdfDecoder,
        camera: gtsam.Pose3 | int,
        points_camera: Float[np.ndarray, "n 3"],
        sigma: Float[np.ndarray, "n"],
        *,
        prior_sigma: float = 0.0,
        share: float | Float[np.ndarray, "n"] = 1.0,
        state_covariance: Float[np.ndarray, "d d"] | Float[np.ndarray, "d"] | None = None,
        tail: float | None = None,
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> None:
        """`sigma` is the sensor's standard deviation in metres; `prior_sigma` the decoder's, canonical; `share` how
        much of an independent measurement each point is, in [0, 1]; `tail` in metres, once rays are sharp."""
        super().__init__(keys, decoder, camera, body_T_camera)
        self._points_camera = checks.reals("surface points", points_camera, (None, 3), PLACES)
        if len(self._points_camera) == 0:
            raise FactorError("surface points of shape (0, 3): at least one is due")
        sigma = checks.reals(
            "the surface points' standard deviations", sigma, (len(self._points_camera),), DEVIATIONS
        )
        self._sensor_sigma = torch.as_tensor(sigma)
        self._prior_sigma = checks.number("prior_sigma", prior_sigma, LENGTHS)
        self._share = checks.shares("the points' share", share, len(self._points_camera))
        self._state_covariance = self._checked(state_covariance)
        self._tail = None if tail is None else checks.number("the tail, or None,", tail, DEVIATIONS)
        self._frozen: _Frozen | None = None
        self._frozen_at: bytes | None = None

    def _checked(self, covariance: np.ndarray | None) -> Float[Tensor, "d d"] | Float[Tensor, "d"] | None:
        """Of the object's state, whole or its diagonal."""
        if covariance is None:
            return None
        length = RIGID_DOF + self.decoder.code_length
        matrix = checks.reals("state_covariance", covariance, None)
        if matrix.shape not in ((length,), (length, length)):
            raise FactorError(
                f"state_covariance has shape {matrix.shape} where {(length, length)} or its diagonal is due"
            )
        if (matrix if matrix.ndim == 1 else np.diag(matrix)).min() < 0:
            raise FactorError("state_covariance has a negative variance")
        return torch.as_tensor(matrix)

    @property
    def is_frozen(self) -> bool:
        return self._frozen is not None

    @property
    def measurements(self) -> float:
        """How many independent measurements its points are, all together."""
        return float(np.broadcast_to(self._share, len(self._points_camera)).sum())

    def refresh(self, values: gtsam.Values, annealing: Annealing = Annealing()) -> None:  # noqa: B008
        state, camera = self.state(values), self.T_world_camera(values)
        if (place := place_of(state, camera, annealing)) == self._frozen_at:
            return
        query = query_points(self.decoder, state, camera, self._points_camera)
        jet = self.decoder.linearize(query.p_object, query.code[None]).cpu()
        self.remember(query, jet.value, jet)
        metric = MetricSdf.of(jet.d_point, state)
        variance = self._sensor_sigma**2 + (self._prior_sigma * metric.metres) ** 2
        if self._state_covariance is not None:
            jacobian = metric.metres[:, None] * sdf_jacobian(query, jet, camera=False).double()
            variance = variance + propagated_variance(jacobian, self._state_covariance).clamp_min(0)
        sigma = variance.sqrt()
        tail = None if self._tail is None else self._tail * (Annealing.slope / annealing.slope) ** 0.5
        self._frozen = _Frozen(
            metric, sigma, torch.as_tensor(self._share) * unit_information_weight(sigma), tail
        )
        self._frozen_at = place if jet.value.isfinite().all() else None

    def points_camera(self) -> np.ndarray:
        return self._points_camera

    def loss_of(self, query: SdfQuery, value: Tensor) -> float:
        metric, sigma, weight, tail = self._held
        score = energy_score(metric.at(query.state) * value.double(), sigma)
        return float((weight * (score if tail is None else bounded_score(score, tail))).sum())

    def active(self, query: SdfQuery, value: Tensor) -> Tensor:
        return torch.arange(len(value), device=value.device)

    def rows_of(self, query: SdfQuery, value: Tensor, jet: SdfJet) -> Rows:
        metric, sigma, weight, tail = self._held
        mu = metric.at(query.state) * value.double()
        if tail is not None:
            weight = weight * bounded_slope(energy_score(mu, sigma), tail)
        root = (weight * majorizing_weight(mu, sigma)).sqrt()
        jacobian = metric.jacobian(query.state, value, self.sdf_jacobian(query, jet))
        return Rows(root[:, None] * jacobian, root * mu, self.loss_of(query, value))

    @property
    def _held(self) -> _Frozen:
        if self._frozen is None:
            raise FactorError("a SurfaceFactor must be refreshed before its parts are evaluated")
        return self._frozen
