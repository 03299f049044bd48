"""How well a detection fits a mapped object: its offset under the joint covariance, overlap and free space.

The mean of a partial view is not the object's centre, so what is tested is the translation u (world frame) that brings
the detection's points onto the object's surface. With metric residuals r = m f of the points moved by u, their
normals H = dr/du and weights W (each point's share of an independent measurement over its variance), u is the weighted
least-squares alignment, found by a few Gauss-Newton steps. Only directions e in which the normals tell the points'
place are used: eigenvectors of H^T W H whose eigenvalue is at least `observable` times the sum of W.

With delta what the estimates of state and camera lack to the truth and n the points' noise, r = n - J delta and
u = G (J delta - n), where G = (E^T H^T W H E)^-1 E^T H^T W: to first order E^T u is normal with the covariance

    C = G (J Sigma J^T + N) G^T + unmodelled^2 I

where Sigma is the joint covariance of object and camera, cross blocks included, and N = W^-1 (points of one patch err
together). Its squared Mahalanobis distance is chi-squared with as many degrees of freedom as there are directions
(Neira and Tardos, "Data association in stochastic mapping using the joint compatibility test", 2001: the individual
test; `objgraph.slam.association.joint` sees to it that all detections share one camera's error).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Float

from factors.sdf import SdfQuery, metres_per_unit, query_points, sdf_jacobian
from factors.sdf_decoder import SdfJet
from factors.state import CAMERA_DOF, RIGID_DOF
from objgraph.covariance.quantile import squared_limit
from objgraph.observation.sampling import ObjectView
from objgraph.slam.association.decode import Asked, decode
from objgraph.slam.association.types import AssociationConfig, MappedCandidate

PairIndex = tuple[int, int]
"""Detection and object."""

_STILL = 2e-3
"""A step shorter than this, metres, is the last one of its pair."""
_HOPELESS = 4.0
"""A pair this many times outside the gate (squared distances) will not come back into it."""
_FREE_SAMPLES = 8
"""Points on a ray at which it is asked whether it passes through the object."""


@dataclass(frozen=True)
class Pair:
    """A detection and the mapped object that it may be of."""

    view: ObjectView
    T_world_camera: gtsam.Pose3
    candidate: MappedCandidate
    covariance: Float[np.ndarray, "d d"]
    """Joint, with or without the camera's columns."""
    camera_error: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(CAMERA_DOF))
    """Of the camera, whitened, by which camera and object are corrected already: part of the offset all the same."""

    @property
    def has_camera(self) -> bool:
        return len(self.covariance) == RIGID_DOF + self.candidate.decoder.code_length + CAMERA_DOF

    @cached_property
    def camera_root(self) -> Float[np.ndarray, "6 6"]:
        """Symmetric root of the camera's covariance, the same for every object of a frame."""
        values, vectors = np.linalg.eigh(self.covariance[-CAMERA_DOF:, -CAMERA_DOF:])
        return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T

    @cached_property
    def covariance_with_camera(self) -> Float[np.ndarray, "d 6"]:
        """Of the state with the camera's whitened error; zero where the camera is known."""
        if not self.has_camera:
            return np.zeros((len(self.covariance), CAMERA_DOF))
        return self.covariance[:, -CAMERA_DOF:] @ np.linalg.pinv(self.camera_root, hermitian=True)

    def corrected(self, T_world_camera: gtsam.Pose3, camera_error: Float[np.ndarray, "6"]) -> "Pair":
        """The same with the camera corrected by a whitened error, and the object where it then is likeliest."""
        error = (self.covariance_with_camera @ camera_error)[: RIGID_DOF + self.candidate.decoder.code_length]
        candidate = replace(self.candidate, state=self.candidate.state.retract(error))
        return replace(self, T_world_camera=T_world_camera, candidate=candidate, camera_error=camera_error)

    @cached_property
    def share(self) -> Float[np.ndarray, "n"]:
        """The part of an independent measurement that each point is."""
        return self.view.points_share


@dataclass(frozen=True)
class Fit:
    """What came out of comparing a pair."""

    offset_world: Float[np.ndarray, "3"]
    """Translation, metres, that brings the detection, seen from the camera as it was taken to stand, onto the object."""
    along: Float[np.ndarray, "k"]
    """The offset's components in the directions in which it is known, from where the camera was first taken to stand."""
    covariance: Float[np.ndarray, "k k"]
    """Of those."""
    shared: Float[np.ndarray, "k 6"]
    """Their covariance with the camera's whitened error: the part that all detections of the frame share."""
    overlap: float
    """Share of the points that lie on the surface, moved by the offset."""
    contradicted: float = 0.0
    """Share of the rays beside the detection that pass through the object, moved likewise; 0 where not asked."""

    @property
    def directions(self) -> int:
        return len(self.along)

    @cached_property
    def squared(self) -> float:
        """Squared Mahalanobis distance of the offset; infinite where nothing is known of it."""
        if not self.directions:
            return np.inf
        return float(self.along @ np.linalg.solve(self.covariance, self.along))

    def seen_as(self, along: Float[np.ndarray, "m"], covariance: Float[np.ndarray, "m m"]) -> "Fit":
        """The same overlap with another offset."""
        return replace(self, along=along, covariance=covariance)

    def limit(self, config: AssociationConfig) -> float:
        """What the squared distance of a true match exceeds once in 1 / (1 - `probability`) times."""
        return squared_limit(config.probability, self.directions)

    def cost(self, config: AssociationConfig) -> float:
        """Twice the negative logarithm of how much likelier a match is than a new object, and what overlap lacks.

        A new object costs 0: it is as likely anywhere in a cube of edge `spacing`.
        """
        log_volume = np.linalg.slogdet(2 * np.pi * self.covariance)[1]
        ratio = self.squared + log_volume - 2 * self.directions * np.log(config.spacing)
        return float(ratio + config.overlap_cost * (1 - self.overlap))

    def describe(self) -> str:
        return (
            f"offset {np.linalg.norm(self.along):.2f} m, d2 {self.squared:.1f} in {self.directions} "
            f"directions, overlap {self.overlap:.2f}"
        )

    def refusal(self, config: AssociationConfig) -> str | None:
        """Why this is no match; None where it may be one."""
        if not np.isfinite(self.squared):
            return "its surface says nothing of where the points lie"
        if self.squared > self.limit(config):
            return f"{self.describe()}: d2 is above {self.limit(config):.1f}"
        if self.overlap < config.overlap:
            return f"{self.describe()}: less than {config.overlap:.2f} overlaps"
        if self.contradicted > config.contradicted:
            return f"{self.describe()}: {self.contradicted:.0%} of the rays beside it pass through the object"
        return None


_NOTHING = Fit(np.zeros(3), np.zeros(0), np.zeros((0, 0)), np.zeros((0, CAMERA_DOF)), 0.0)
"""Where the decoder is not finite, or has no slope at the points."""


@dataclass(frozen=True)
class _Rows:
    """One pair's points linearised, metres."""

    residual: Float[np.ndarray, "n"]
    normal_world: Float[np.ndarray, "n 3"]
    jacobian: Float[np.ndarray, "n d"]
    information: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    """The information, less for points far off the surface."""

    @property
    def usable(self) -> bool:
        return bool(np.isfinite(self.residual).all() and np.isfinite(self.jacobian).all())

    def alignment(self, observable: float) -> tuple[Float[np.ndarray, "3 k"], Float[np.ndarray, "k n"]]:
        """Observed directions E, and G: the offset along them is -G residual."""
        weighted = self.weight[:, None] * self.normal_world
        values, vectors = np.linalg.eigh(self.normal_world.T @ weighted)
        kept = values > observable * self.weight.sum()
        directions = vectors[:, kept]
        return directions, (directions.T @ weighted.T) / values[kept, None]


def compare(pairs: Mapping[PairIndex, Pair], config: AssociationConfig) -> dict[PairIndex, Fit]:
    """The fit of every pair; the decoder's work for all is done in at most `config.steps` + 1 calls.

    A pair is moved no further once it lies still or is far outside the gate; free space is asked for where nothing
    else refuses the pair.

    Raises:
        FactorError: an object's code is of another length than its decoder's.
    """
    fits = dict.fromkeys(pairs, _NOTHING)
    moving = list(pairs)
    for _ in range(config.steps):
        queries = {i: _moved(pairs[i], fits[i].offset_world, pairs[i].view.points_camera) for i in moving}
        for i, jet in _decode(pairs, queries).items():
            before = fits[i].offset_world
            fits[i] = _fit(pairs[i], _rows(pairs[i], queries[i], jet, config), before, config)
            still = np.linalg.norm(fits[i].offset_world - before) < _STILL
            if still or fits[i].squared > _HOPELESS * fits[i].limit(config):
                moving.remove(i)
    left = [i for i, fit in fits.items() if fit.refusal(config) is None]
    queries = {i: _free_query(pairs[i], fits[i].offset_world) for i in left}
    for i, jet in _decode(pairs, queries).items():
        fits[i] = replace(fits[i], contradicted=_contradicted(pairs[i], jet, config))
    return fits


def _fit(pair: Pair, rows: _Rows, offset: Float[np.ndarray, "3"], config: AssociationConfig) -> Fit:
    """What the rows at `offset` say, the next step included."""
    if not rows.usable:
        return _NOTHING
    directions, gain = rows.alignment(config.observable)
    step = -gain @ rows.residual
    moved = gain @ rows.jacobian
    covariance = moved @ pair.covariance @ moved.T + (gain / rows.information) @ gain.T
    shared = moved @ pair.covariance_with_camera
    return Fit(
        offset + directions @ step,
        directions.T @ offset + step + shared @ pair.camera_error,
        covariance + config.unmodelled**2 * np.eye(len(step)),
        shared,
        float(np.mean(np.abs(rows.residual) <= config.distance)),
    )


def _free_query(pair: Pair, offset: Float[np.ndarray, "3"]) -> SdfQuery:
    """Points seen to be empty, `_FREE_SAMPLES` on each ray that passes the detection, about its depth."""
    rays = pair.view.rays
    free = ~rays.hit & (rays.end > rays.depth)
    radius = pair.candidate.radius
    last = np.minimum(rays.depth[free] + radius, rays.end[free])
    depth = np.linspace(np.maximum(rays.depth[free] - 0.5 * radius, 0.0), last, _FREE_SAMPLES, axis=1)
    return _moved(pair, offset, (rays.directions_camera[free, None] * depth[:, :, None]).reshape(-1, 3))


def _moved(pair: Pair, offset: Float[np.ndarray, "3"], p_camera: Float[np.ndarray, "n 3"]) -> SdfQuery:
    """Camera points in the object's frame, had the camera stood `offset` (world frame) from where it is taken to."""
    T = pair.T_world_camera
    T_world_moved = gtsam.Pose3(T.rotation(), T.translation() + offset)
    return query_points(pair.candidate.decoder, pair.candidate.state, T_world_moved, p_camera)


def _decode(
    pairs: Mapping[PairIndex, Pair], queries: Mapping[PairIndex, SdfQuery]
) -> dict[PairIndex, SdfJet]:
    asked = [Asked(pairs[i].candidate.decoder, query.code, query.p_object) for i, query in queries.items()]
    return dict(zip(queries, decode(asked), strict=True))


def _rows(pair: Pair, query: SdfQuery, jet: SdfJet, config: AssociationConfig) -> _Rows:
    state = pair.candidate.state
    metres = metres_per_unit(jet.d_point, state).double()
    residual = (metres * jet.value.double()).cpu().numpy()
    jacobian = (metres[:, None] * sdf_jacobian(query, jet, pair.has_camera).double()).cpu().numpy()
    # the object moved by its translation is the points moved the other way
    normal_world = -jacobian[:, 3:6] @ state.T_world_object.rotation().matrix().T
    own = pair.candidate.residual_sigma * metres.cpu().numpy()
    information = pair.share / (np.square(pair.view.points_sigma) + np.square(own))
    # Huber's: points off the surface pull no harder than those at `distance`, stray pixels are not the object's
    robust = config.distance / np.maximum(np.abs(residual), config.distance)
    return _Rows(residual, normal_world, jacobian, information, information * robust)


def _contradicted(pair: Pair, jet: SdfJet, config: AssociationConfig) -> float:
    if not len(jet.value):
        return 0.0
    inside = -(metres_per_unit(jet.d_point, pair.candidate.state) * jet.value)
    deepest = inside.reshape(-1, _FREE_SAMPLES).amax(dim=1)
    return float((deepest > config.inside).double().mean())
