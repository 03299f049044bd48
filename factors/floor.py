"""The floor factor: nothing of an object lies below the floor, and what stands on it touches it."""

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.base import Annealing
from factors.checks import DEVIATIONS, LENGTHS, PLACES
from factors.depth import DepthFactor, RaySampling
from factors.errors import NotFiniteError
from factors.full_distribution import FullDistribution
from factors.keys import readable_key
from factors.rays import BOX_HALF_SIZE, Rays
from factors.reduce import Rows
from factors.score import cauchy_root, cauchy_score
from factors.sdf import SdfQuery, sdf_jacobian
from factors.sdf_decoder import SdfDecoder, SdfJet
from factors.state import CAMERA_DOF, POSE_DOF, ObjectKeys, ObjectState

_BELOW = 3.0
"""Depth of the imagined camera under the floor, metres ..."""
_UNDER = 1.0
"""... or so far under what of the object may be lowest, where that is more."""
SPACING = 0.08
"""Metres between rays at the floor: dense enough that few legs go on unseen under it."""
SPACINGS = checks.Range(1e-3, 1e3)
"""Metres between rays that can be told apart and counted."""
_WIDEST = 30
"""Rays to either side of the middle at most."""
_CORRELATION_LENGTH = 0.2
"""Metres: a floor errs together over so much, as every surface does."""
_LITTLE = RaySampling(coarse=4, cells=4)
"""Rays from below pass the little of the object's box that is under the floor."""
_TOUCH = 0.01
"""Metres between the lower side of an object's box and its feet: a decoder draws their ends a little short."""
_LIFTED = 3.0
"""Standard deviations of the gap under an object beyond which it is taken less and less to stand on the floor."""
_LEVEL = 1e-3
"""An x axis whose level part is shorter than this has no heading."""


class FloorFactor(DepthFactor):
    """Scores of rays from below that end at the floor without having met the object, and of the gap under its feet.

    The imagined camera goes along with the object over the floor and turns with it: the floor is the same everywhere,
    so the factor says nothing of where on it the object stands, nor which way it faces. (Rays that stay where they are
    do, by falling beside a foot or on it: a false anchor of every object in the world.)

    Of an object that `stands` the lower side of the box that its decoder's shapes fill is at the floor as well. That
    score is Cauchy's: an object that the views see to hang or to lie on something is let go.

    Frozen by `refresh`, beside what `DepthFactor` freezes: the rays, which cover the object's box.
    """

    def __init__(
        self,
        keys: ObjectKeys,
        decoder: SdfDecoder,
        up_world: Float[np.ndarray, "3"],
        floor: float,
        *,
        sigma: float = 0.01,
        spacing: float = SPACING,
        stands: float | None = None,
        prior_sigma: float = 0.0,
        share: float | None = None,
        half_box: float | Float[np.ndarray, "3"] = BOX_HALF_SIZE,
    ) -> None:
        """`floor` is its height along `up_world` and `sigma` how well that is known, both in metres; `spacing` is that of
        the rays at the floor, metres.

        `stands`: canonical distance from the object's origin down to its feet; None where it need not stand.

        `share` is how much of an independent measurement each ray is, by default `floor_share` of how far apart they are.

        Raises:
            FactorError: `up_world` has no direction, or the floor no height.
        """
        self._up = checks.direction("the floor's up_world", up_world)
        self._floor = checks.number("the floor's height", floor, PLACES)
        self._sigma = checks.number("the floor's sigma", sigma, DEVIATIONS)
        self._spacing = checks.number("the floor's spacing", spacing, SPACINGS)
        self._below, self._by_spacing = _BELOW, share is None
        self._stands = None if stands is None else checks.number("stands, or None,", stands, LENGTHS)
        super().__init__(
            keys, decoder, gtsam.Pose3(), _rays_from_below(1.0, _BELOW, sigma, spacing),
            # a Gaussian of the depth does not count a free ray that ends inside the box
            renderer=FullDistribution(), prior_sigma=prior_sigma, sampling=_LITTLE,
            share=floor_share(spacing) if share is None else checks.number("a floor's share", share, checks.SHARES),
            half_box=half_box,
        )  # fmt: skip

    def T_world_camera(self, values: gtsam.Values) -> gtsam.Pose3:
        """Under the object, looking up, its x axis along the object's."""
        pose = values.atPose3(self.object_keys.pose)
        x = _level_axis(pose.rotation().matrix()[:, 0], self._up)
        below = self._floor - self._below - self._up @ pose.translation()
        R_world_camera = np.stack([x, np.cross(self._up, x), self._up], axis=1)
        return gtsam.Pose3(gtsam.Rot3(R_world_camera), pose.translation() + below * self._up)

    def refresh(self, values: gtsam.Values, annealing: Annealing = Annealing()) -> None:  # noqa: B008
        state = self.state(values)
        reach = float(np.linalg.norm(np.broadcast_to(self._half_box, 3)) * state.scale.max())
        if not np.isfinite(reach):
            raise NotFiniteError(f"{readable_key(self.object_keys.log_scale)} holds a scale without end")
        lowest = float(self._up @ state.T_world_object.translation()) - reach
        self._below = max(_BELOW, self._floor - lowest + _UNDER)
        # of what is larger than any furniture they are farther apart, and each counts for more
        spacing = max(self._spacing, reach / _WIDEST)
        if self._by_spacing:
            self._share = np.array(floor_share(spacing))
        self._rays = _rays_from_below(reach, self._below, self._sigma, spacing)
        super().refresh(values, annealing)

    def sdf_jacobian(self, query: SdfQuery, jet: SdfJet) -> Float[Tensor, "n d"]:
        """As if the camera were a variable, carried through to the object's pose, which it follows."""
        full = sdf_jacobian(query, jet, camera=True)
        own, camera = full[:, :-CAMERA_DOF], full[:, -CAMERA_DOF:]
        follows = camera_from_pose(query.state.T_world_object, query.T_world_camera)
        through = camera @ torch.as_tensor(follows, dtype=full.dtype, device=full.device)
        return torch.cat([own[:, :POSE_DOF] + through, own[:, POSE_DOF:]], dim=1)

    def loss(self, values: gtsam.Values) -> float:
        gap = self._gap(self.state(values))
        return super().loss(values) + (0.0 if gap is None else float(cauchy_score(gap[0], _LIFTED)))

    def rows_of(self, query: SdfQuery, value: Tensor, jet: SdfJet) -> Rows:
        rows = super().rows_of(query, value, jet)
        gap = self._gap(query.state)
        if gap is None:
            return rows
        r, jacobian = gap
        root = cauchy_root(r, _LIFTED)
        row, residual = (root * jacobian)[None].to(rows.jacobian), (root * r)[None].to(rows.residual)
        loss = rows.loss + float(cauchy_score(r, _LIFTED))
        return Rows(torch.cat([rows.jacobian, row]), torch.cat([rows.residual, residual]), loss)

    def _gap(self, state: ObjectState) -> tuple[Float[Tensor, ""], Float[Tensor, "d"]] | None:
        """Height of the feet over the floor in standard deviations, and its derivative; None if it need not stand."""
        if self._stands is None:
            return None
        up_object = self._up @ state.T_world_object.rotation().matrix()
        foot = np.array([0.0, -self._stands * state.scale[1], 0.0])
        height = self._up @ state.T_world_object.translation() + up_object @ foot - self._floor
        jacobian = np.zeros(sum(self.dims))
        jacobian[:3], jacobian[3:6] = np.cross(foot, up_object), up_object
        jacobian[POSE_DOF + 1] = up_object @ foot
        sigma = np.hypot(self._sigma, _TOUCH)
        return torch.as_tensor(height / sigma), torch.as_tensor(jacobian / sigma)


def camera_from_pose(T_world_object: gtsam.Pose3, T_world_camera: gtsam.Pose3) -> Float[np.ndarray, "6 6"]:
    """Derivative of the imagined camera's tangent w.r.t. the object's, both in their body frames."""
    R_world_object, R_world_camera = T_world_object.rotation().matrix(), T_world_camera.rotation().matrix()
    up = R_world_camera[:, 2]
    along = up @ R_world_object
    follows = np.zeros((CAMERA_DOF, POSE_DOF))
    level = 1.0 - along[0] ** 2
    if level > _LEVEL**2:  # the x axis' heading: turned by the rotation about y and about z
        follows[2, 1:3] = along[1:] / level
    follows[3:, 3:] = R_world_camera.T @ (np.eye(3) - np.outer(up, up)) @ R_world_object
    return follows


def _level_axis(axis: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Unit level direction of `axis`; a fixed one where it is vertical."""
    level = axis - (up @ axis) * up
    if np.linalg.norm(level) <= _LEVEL:
        level = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    return level / np.linalg.norm(level)


def floor_share(spacing: float) -> float:
    """The part of an independent measurement that each of the floor's rays is, `spacing` metres from the next."""
    return min(1.0, (checks.number("the floor's spacing", spacing, SPACINGS) / _CORRELATION_LENGTH) ** 2)


def _rays_from_below(reach: float, below: float, sigma: float, spacing: float) -> Rays:
    """Rays that look up from `below` metres under the floor and are free as far as it, `reach` metres about the middle.

    Their pattern is turned and off the middle: the legs of a symmetric shape are not hit or missed all at once.
    """
    count = int(np.ceil(reach / spacing)) + 2
    steps = np.arange(-count, count + 1)
    i, j = (axis.ravel() for axis in np.meshgrid(steps + 0.31, steps + 0.17))
    across = spacing * np.column_stack([0.88 * i - 0.475 * j, 0.475 * i + 0.88 * j])
    across = across[np.linalg.norm(across, axis=1) <= reach + spacing]
    depth = np.full(len(across), below)
    directions = np.column_stack([across / below, np.ones(len(across))])
    return Rays(directions, depth, np.zeros(len(across), dtype=bool), depth, np.full(len(across), sigma))
