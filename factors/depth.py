"""The 2D factor: rays of one view end on the object where the depth image says so (paper L_2D, equ:2d_loss)."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.base import Annealing, ObservationFactor, place_of
from factors.checks import LENGTHS
from factors.errors import FactorError
from factors.full_distribution import FullDistribution
from factors.rays import (
    BOX_HALF_SIZE,
    RayCells,
    Rays,
    box_interval,
    choose_cells,
    coarse_depths,
    empty_cells,
    passing_depth,
)
from factors.reduce import Rows
from factors.rendering import CLEAR, RaySamples, RayTargets, RenderedRows, Renderer
from factors.score import unit_information_weight
from factors.sdf import MetricSdf, SdfQuery, query_points
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import ObjectKeys, ObjectState

_NEGLIGIBLE = 1e-7
"""A cell whose derivative is smaller than this share of the largest is not differentiated."""


_NEAR = 0.1
"""Canonical distance from the surface within which the decoder's own gradient gives the metric."""


@dataclass(frozen=True)
class RaySampling:
    """How finely rays are cut."""

    coarse: int = 12
    """Equal steps through the object's box that find the surface, at every refresh."""
    cells: int = 10
    """Cells a ray that the factor decodes at every evaluation."""

    def __post_init__(self) -> None:
        """Raises FactorError where one is no number of steps."""
        checks.settings(self, coarse=checks.Range(1, 500), cells=checks.Range(2, 500))


@dataclass(frozen=True)
class _Frozen:
    rays: np.ndarray
    """Indices of the rays that meet the box before they end."""
    cells: RayCells
    targets: RayTargets
    p_camera: np.ndarray
    metric: MetricSdf
    """Of all cells, ray by ray."""
    sdf_sigma: Tensor
    spread: Tensor
    weight: Tensor
    slope: float
    missed: float
    """Weighted score of the hits whose rays do not meet the box."""


class _Rendered(NamedTuple):
    """What was rendered last, and of what."""

    value: Tensor
    frozen: _Frozen
    rows: RenderedRows
    active: Tensor


class DepthFactor(ObservationFactor):
    """Scores of the rendered depth of one view's rays.

    A ray that does not meet the object's box passes the object: a free one is as it should be, a hit is not.

    Frozen by `refresh`: which rays meet the object's box, their cells, each cell's gradient (by which metres follow
    the scale) and standard deviation, the occupancy slope and each ray's spread.
    """

    def __init__(
        self,
        keys: ObjectKeys,
        decoder: SdfDecoder,
        camera: gtsam.Pose3 | int,
        rays: Rays,
        *,
        renderer: Renderer | None = None,
        prior_sigma: float = 0.0,
        share: float | Float[np.ndarray, "r"] = 1.0,
        sampling: RaySampling | None = None,
        half_box: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE,
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> None:
        """`prior_sigma` is the decoder's standard deviation in canonical units; `share` is how much of an
        independent measurement each ray is, in [0, 1]; `half_box` are half the edges of the canonical box that holds the
        shapes: rays are cut within it."""
        super().__init__(keys, decoder, camera, body_T_camera)
        self._rays = checks.instance("rays", rays, Rays)
        self._renderer = FullDistribution() if renderer is None else renderer
        if isinstance(renderer, type) or not hasattr(self._renderer, "render"):
            raise FactorError(f"{renderer!r} is no renderer: FullDistribution() is one")
        self._prior_sigma = checks.number("prior_sigma", prior_sigma, LENGTHS)
        self._share = checks.shares("the rays' share", share, len(self._rays.depth))
        self._sampling = (
            RaySampling() if sampling is None else checks.instance("sampling", sampling, RaySampling)
        )
        self._half_box = checks.reals("half_box", half_box, None, checks.POSITIVE)
        if self._half_box.shape not in ((), (3,)):
            raise FactorError(f"half_box has shape {self._half_box.shape} where one edge or three are due")
        self._frozen: _Frozen | None = None
        self._rendered: _Rendered | None = None
        self._frozen_at: bytes | None = None

    @property
    def is_frozen(self) -> bool:
        return self._frozen is not None

    def refresh(self, values: gtsam.Values, annealing: Annealing = Annealing()) -> None:  # noqa: B008
        state, camera = self.state(values), self.T_world_camera(values)
        if (place := place_of(state, camera, annealing)) == self._frozen_at:
            return
        near, far = box_interval(
            state, camera, self._rays.directions_camera, self._half_box, self._rays.origins_camera
        )
        crosses = (far - near > 1e-3) & (self._rays.end > near)
        meets = np.flatnonzero(crosses)
        targets = self._targets(meets)
        cells = self._choose_cells(state, camera, near[meets], far[meets], meets, targets, annealing)
        p_camera = self._points(meets, cells.depth)
        query = query_points(self.decoder, state, camera, p_camera)
        with torch.no_grad():
            value = self.decoder(query.p_object, query.code[None]).cpu()
        self.remember(query, value)
        metric = self._metric(query, value, state)
        metres = metric.metres.view_as(cells.depth)
        sdf, sdf_sigma = metres * value.double().view_as(metres), self._prior_sigma * metres
        samples = RaySamples(sdf, sdf_sigma.clamp_min(1e-6), cells, targets, annealing.slope)
        spread = self._renderer.freeze(samples)
        self._frozen = _Frozen(
            meets, cells, targets, p_camera, metric, samples.sdf_sigma, spread,
            self._weight(meets, spread), annealing.slope,
            self._missed(np.flatnonzero(self._rays.hit & ~crosses), state, camera, annealing),
        )  # fmt: skip
        self._frozen_at = place if value.isfinite().all() else None

    def points_camera(self) -> np.ndarray:
        return self._held.p_camera

    def loss_of(self, query: SdfQuery, value: Tensor) -> float:
        frozen, last = self._held, self._rendered
        if last is not None and last.value is value and last.frozen is frozen:
            loss = last.rows.loss
        else:
            loss = self._renderer.loss(self._samples(query, value), frozen.spread)
        return float((frozen.weight * loss).sum()) + frozen.missed

    def active(self, query: SdfQuery, value: Tensor) -> Tensor:
        return self._render(query, value).active

    def rows_of(self, query: SdfQuery, value: Tensor, jet: SdfJet) -> Rows:
        frozen = self._held
        rendered = self._render(query, value).rows
        root = frozen.weight.sqrt()[:, None]
        residual = (root * rendered.residual).flatten()
        rows = self._quantity_jacobian(query, value, jet, root[..., None] * rendered.d_sdf)
        speaks = (residual != 0) | (rows.abs().amax(dim=1) > 0)
        loss = float((frozen.weight * rendered.loss).sum()) + frozen.missed
        return Rows(rows[speaks], residual[speaks], loss)

    def _quantity_jacobian(self, query: SdfQuery, value: Tensor, jet: SdfJet, d_sdf: Tensor) -> Tensor:
        """Chain rule: rows (r * q, d) of quantities whose derivative w.r.t. the cells' metric SDF is (r, q, k)."""
        active, shape = self.active(query, value), self._held.cells.depth.shape
        some = self.sdf_jacobian(query.take(active), jet)
        jacobian = torch.zeros(len(value), some.shape[1], dtype=torch.float64)
        jacobian[active] = self._held.metric.take(active).jacobian(query.state, value[active], some)
        return torch.bmm(d_sdf, jacobian.unflatten(0, shape)).flatten(0, 1)

    def _samples(self, query: SdfQuery, value: Tensor) -> RaySamples:
        frozen = self._held
        sdf = (frozen.metric.at(query.state) * value.double()).view_as(frozen.cells.depth)
        return RaySamples(sdf, frozen.sdf_sigma, frozen.cells, frozen.targets, frozen.slope)

    def _render(self, query: SdfQuery, value: Tensor) -> "_Rendered":
        """Rows, and whose derivatives matter; an evaluation asks for both several times."""
        frozen, last = self._held, self._rendered
        if last is not None and last.value is value and last.frozen is frozen:
            return last
        rows = self._renderer.render(self._samples(query, value), frozen.spread)
        strength = (frozen.weight.sqrt()[:, None, None] * rows.d_sdf).abs().amax(dim=1)
        active = torch.zeros(0, dtype=torch.long)  # where no ray meets the object's box
        if strength.numel():
            active = torch.nonzero((strength > _NEGLIGIBLE * strength.max()).flatten())[:, 0]
        self._rendered = _Rendered(value, frozen, rows, active)
        return self._rendered

    def _targets(self, rays: np.ndarray) -> RayTargets:
        return RayTargets(
            *(torch.as_tensor(getattr(self._rays, name)[rays]) for name in ("depth", "hit", "end", "sigma"))
        )

    def _weight(self, rays: np.ndarray, spread: Tensor) -> Tensor:
        share = self._share if self._share.ndim == 0 else self._share[rays]
        return torch.as_tensor(share) * unit_information_weight(spread)

    def _missed(
        self, rays: np.ndarray, state: ObjectState, camera: gtsam.Pose3, annealing: Annealing
    ) -> float:
        """Weighted score of hits that pass the object without meeting its box."""
        if not len(rays):
            return 0.0
        beside = self._rays.depth_beside(camera.transformTo(state.T_world_object.translation()))[rays]
        targets = self._targets(rays)
        far = torch.as_tensor(passing_depth(state, self._rays.depth[rays], beside, self._half_box))
        sigma = torch.full((len(rays), 1), self._prior_sigma * float(np.exp(state.log_scale.mean())))
        sdf = torch.full_like(far, CLEAR)[:, None]
        samples = RaySamples(sdf, sigma.to(sdf).clamp_min(1e-6), empty_cells(far), targets, annealing.slope)
        spread = self._renderer.freeze(samples)
        return float((self._weight(rays, spread) * self._renderer.render(samples, spread).loss).sum())

    def _choose_cells(
        self,
        state: ObjectState,
        camera: gtsam.Pose3,
        near: np.ndarray,
        far: np.ndarray,
        meets: np.ndarray,
        targets: RayTargets,
        annealing: Annealing,
    ) -> RayCells:
        # what lies beyond a ray's end is in no residual: no cell is spent on it
        start, end = torch.as_tensor(near), torch.minimum(torch.as_tensor(far), targets.end)
        coarse = coarse_depths(start, end, self._sampling.coarse)
        query = query_points(self.decoder, state, camera, self._points(meets, coarse))
        with torch.no_grad():
            sdf = self.decoder(query.p_object, query.code[None]).cpu().double().view_as(coarse)
        metres = float(np.exp(state.log_scale.mean()))
        band = (0.5 * (end - start) / self._sampling.coarse).clamp_min(2.0 / annealing.slope)
        step_at = torch.minimum(targets.stop, targets.end)
        cells = choose_cells(start, end, metres * sdf, targets.depth, step_at, self._sampling.cells, band)
        return replace(cells, far=torch.as_tensor(far))

    def _metric(self, query: SdfQuery, value: Tensor, state: ObjectState) -> MetricSdf:
        """Metres per canonical unit of every cell; away from the surface, where it hardly matters, their mean."""
        metres = torch.full((len(value),), float(np.exp(state.log_scale.mean())), dtype=torch.float64)
        share = torch.full((len(value), 3), 1 / 3, dtype=torch.float64)
        near = torch.nonzero(value.abs() < _NEAR)[:, 0]
        if len(near):
            d_point = self.decoder.gradient(query.take(near).p_object, query.code).cpu()
            metres[near], share[near], _ = MetricSdf.of(d_point, state)
        return MetricSdf(metres, share, np.array(state.log_scale))

    def _points(self, rays: np.ndarray, depth: Tensor) -> np.ndarray:
        points = self._rays.directions_camera[rays][:, None, :] * depth.numpy()[:, :, None]
        if self._rays.origins_camera is not None:
            points += self._rays.origins_camera[rays][:, None, :]
        return points.reshape(-1, 3)

    @property
    def _held(self) -> _Frozen:
        if self._frozen is None:
            raise FactorError("a DepthFactor must be refreshed before its parts are evaluated")
        return self._frozen
