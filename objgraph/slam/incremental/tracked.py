"""An object of the incremental map: its variables, what it was seen in, and when that must be linearised anew."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from jaxtyping import Float

from factors.base import Annealing, ObservationFactor
from factors.batch import prefetch
from factors.linearized import linearized
from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.association import MappedCandidate
from objgraph.slam.incremental.config import Tolerance

_TRAVELLED = 0.05
"""Radians or metres of common motion after which a quadratic is carried along: it distorts steps by that share."""


@dataclass
class Observation:
    """The factors of one view on one object, or what is known of it without one, and their quadratic in the smoother."""

    factors: list[ObservationFactor]
    view: ObjectView | None
    """None for what no view says: of the floor, of the box."""
    of_prior: bool = False
    """Whether it comes with the prior, as the box does, and so with every graph that the object is put in."""
    point: gtsam.Values = field(default_factory=gtsam.Values)
    """Where they were linearised."""
    quadratic: gtsam.LinearContainerFactor | None = None
    number: int = -1
    """Of the quadratic among the smoother's factors."""

    @property
    def keys(self) -> list[int]:
        return self.factors[0].keys

    @property
    def camera(self) -> int | None:
        """The camera's key; None where it is not a variable."""
        camera = self.factors[0].camera
        return camera if isinstance(camera, int) else None


@dataclass
class TrackedObject:
    """One object of the map."""

    name: str
    keys: ObjectKeys
    prior: ShapePrior
    observations: list[Observation] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    """Its priors' numbers among the smoother's factors."""
    views: int = 0
    """How often it was ever seen; with a lag, more than it has observations of."""
    views_solved: int = 0
    """How often it had been seen when it was last solved as a whole."""
    other_headings: HeadingModes | None = None
    """How likely it stands as estimated or turned, by the views there were when it was last solved as a whole."""

    @property
    def placed_views(self) -> list[tuple[int, ObjectView]]:
        """Its views and the keys of their cameras."""
        return [(o.camera, o.view) for o in self.observations if o.camera is not None and o.view is not None]

    @property
    def has_lost_views(self) -> bool:
        """Whether views of it are past the lag, once the system has pruned it: what they said is in the smoother for good."""
        return len(self.placed_views) < self.views

    @property
    def is_due(self) -> bool:
        """Whether it is to be solved again as a whole: at 5 views, then each time that they have doubled (9, 17, ...)."""
        return self.views >= twice(self.views_solved)

    def candidate(
        self, state: ObjectState, covariance: Callable[[], Float[np.ndarray, "d d"]]
    ) -> MappedCandidate:
        """What association needs; the covariance is that of the object and the camera together."""
        prior = self.prior
        return MappedCandidate(
            self.name, prior.category, prior.decoder, state, covariance, prior.residual_sigma
        )

    def has_travelled(self, observation: Observation, values: gtsam.Values) -> bool:
        """Whether camera and object are far from where they were when the observation was linearised."""
        camera = observation.camera
        if camera is None:
            return False
        motion = gtsam.Pose3.Logmap(observation.point.atPose3(camera).between(values.atPose3(camera)))
        return bool(np.abs(motion).max() > _TRAVELLED)

    def departure(
        self,
        observation: Observation,
        values: gtsam.Values,
        tolerance: Tolerance,
    ) -> float:
        """How far an observation is from where it was linearised; more than 1 is too far."""
        factor = observation.factors[0]
        now, then = (_relative(factor, at) for at in (values, observation.point))
        motion = gtsam.Pose3.Logmap(then[0].between(now[0]))
        code_sigma = np.sqrt(np.diag(self.prior.code_covariance))
        changes = (
            np.linalg.norm(motion[:3]) / tolerance.rotation,
            np.linalg.norm(motion[3:]) / tolerance.translation,
            np.abs(now[1].log_scale - then[1].log_scale).max() / tolerance.log_scale,
            np.sqrt(np.mean(np.square((now[1].code - then[1].code) / code_sigma))) / tolerance.code,
        )
        return float(max(changes))


def linearize(
    observations: Sequence[Observation], values: gtsam.Values, slope: float
) -> list[gtsam.LinearContainerFactor]:
    """Freeze the observations at `values` and make their quadratics there; all decode together."""
    freeze(observations, values, slope)
    return linearize_frozen(observations, values)


def freeze(observations: Sequence[Observation], values: gtsam.Values, slope: float) -> None:
    """Draw the observations' samples, and take their noise, at `values`."""
    for observation in observations:
        for factor in observation.factors:
            factor.refresh(values, Annealing(slope))


def linearize_frozen(
    observations: Sequence[Observation], values: gtsam.Values
) -> list[gtsam.LinearContainerFactor]:
    """The observations' quadratics at `values`, with what is frozen as it is; all decode together."""
    prefetch([factor for o in observations for factor in o.factors], values, jacobian=True)
    return [linearized(observation.factors, values) for observation in observations]


def cameras_of(observations: Sequence[Observation]) -> list[int]:
    """Keys of the cameras that are variables."""
    return sorted({o.camera for o in observations if o.camera is not None})


def entered(
    observations: Sequence[Observation],
    quadratics: Sequence[gtsam.LinearContainerFactor],
    numbers: Sequence[int],
    at: gtsam.Values,
) -> None:
    """Note that the observations are in the smoother by these quadratics, made at `at`, under these numbers."""
    for observation, quadratic, number in zip(observations, quadratics, numbers, strict=True):
        observation.quadratic, observation.number = quadratic, number
        observation.point = at.extract(gtsam.KeyVector(observation.keys))


def _relative(factor: ObservationFactor, values: gtsam.Values) -> tuple[gtsam.Pose3, ObjectState]:
    """The object's pose in the camera's frame, and its state."""
    state = factor.state(values)
    return factor.T_world_camera(values).between(state.T_world_object), state


def twice(views: int) -> int:
    """How many views tell as much more as those did: 5, then 9, 17, ..."""
    return max(5, 2 * views - 1)
