"""Objects that have been seen but not often enough to enter the map."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from jaxtyping import Float

from objgraph.estimate.task import Estimate
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.association import MappedCandidate
from objgraph.slam.incremental.config import IncrementalConfig


@dataclass
class PendingObject:
    """What is known of an object before it enters: its views, each from a camera of the map, and a first estimate."""

    index: int
    """Of its keys."""
    name: str
    prior: ShapePrior
    estimate: Estimate
    last_seen: int
    """Number of the frame."""
    views: list[tuple[int, ObjectView]] = field(default_factory=list)
    """Camera keys and views."""
    cameras: dict[int, gtsam.Pose3] = field(default_factory=dict)
    """T_world_camera of the views, where the estimate belongs to them."""
    awaited: int = 0
    """Sightings that are due before it may enter, where fewer left it in doubt."""
    sightings: int = 1
    """How often it was ever seen; with a lag, more than it has views of."""

    def see(self, camera: int, T_world_camera: gtsam.Pose3, view: ObjectView, number: int) -> None:
        """One more view, in the frame of this number."""
        self.views.append((camera, view))
        self.cameras[camera] = T_world_camera
        self.last_seen = number
        self.sightings += 1

    def follow(self, cameras: dict[int, gtsam.Pose3]) -> None:
        """Go along with the cameras that saw it, which the map may have moved; views of others are forgotten."""
        self.views = [(key, view) for key, view in self.views if key in cameras]
        if self.views:
            first, state = self.views[0][0], self.estimate.state
            motion = cameras[first].compose(self.cameras[first].inverse())
            moved = replace(state, T_world_object=motion.compose(state.T_world_object))
            self.estimate = replace(self.estimate, state=moved)
        self.cameras = cameras

    def candidate(
        self, with_camera: Callable[[Float[np.ndarray, "d d"]], Float[np.ndarray, "d+6 d+6"]] | None = None
    ) -> MappedCandidate:
        """What association needs; `with_camera` makes of the covariance as seen from the first view's camera that of object and new
        camera together."""
        assert self.estimate.covariance is not None
        own, prior = self.estimate.covariance.matrix, self.prior
        return MappedCandidate(
            self.name, prior.category, prior.decoder, self.estimate.state,
            lambda: own if with_camera is None else with_camera(own), prior.residual_sigma,
        )  # fmt: skip

    def is_ripe(self, config: IncrementalConfig) -> bool:
        """Whether it was seen often enough, and from directions that differ enough."""
        if len(self.views) < config.views_to_enter or self.sightings < self.awaited:
            return False
        centre = self.estimate.state.T_world_object.translation()
        towards = [self.cameras[key].translation() - centre for key, _ in self.views]
        return config.views_to_enter == 1 or any(
            _angle(a, b) > config.baseline for a, b in itertools.combinations(towards, 2)
        )


def _angle(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
