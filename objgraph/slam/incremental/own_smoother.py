"""Objects for a smoother that the caller owns and updates: each frame's step says what to add and what to remove."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import ConfigError, ObservationError, SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.observation.frames import Frame, Instance
from objgraph.observation.sampling import ObjectView
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.front_end import FrameReport, FrontEnd, checked
from objgraph.slam.incremental.motion import known_already
from objgraph.slam.incremental.staged import StagedSmoother
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject
from objgraph.work import torch_threads


@dataclass(frozen=True)
class Step:
    """What a frame's objects ask of the caller's smoother."""

    factors: gtsam.NonlinearFactorGraph
    """To be added."""
    values: gtsam.Values
    """Of the variables that are new: objects that enter."""
    remove: list[int]
    """Slots of factors that earlier steps have added and that these replace."""
    alive: tuple[int, ...]
    """The variables of all objects: a fixed-lag smoother must be given the present time for them."""
    report: FrameReport


class ObjectFrontEnd:
    """Tracks objects in the caller's own ISAM2 or fixed-lag smoother, which it reads and never changes.

    For each frame, once its camera is in the smoother:

        step = objects.step(frame, detections, camera=X(k))
        result = isam.update(step.factors, step.values, gtsam.KeyVector(step.remove))
        objects.accept(result.getNewFactorsIndices())

    The caller's odometry, loop closures and whatever else are his. What is added are linear factors; only the prior
    of codes that are of several kinds (`ShapePrior.kinds`) calls back into Python from the smoother.
    """

    def __init__(
        self,
        smoother: gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother,
        up_world: Float[np.ndarray, "3"],
        *,
        floor: float | None = None,
        config: IncrementalConfig | None = None,
        find_prior: Callable[[str], ShapePrior] = prior_for,
        body_T_camera: gtsam.Pose3 | None = None,
        object_keys: Callable[[int], ObjectKeys] = ObjectKeys.numbered,
    ) -> None:
        """`up_world` is the unit vector against gravity in the smoother's world, `floor` the floor's height along it.

        With `body_T_camera` the keys given to `step` are of the body's pose. `object_keys` gives the keys of the n-th
        object, which must be free in the smoother. Of `config` the odometry, the anchor and the lag are not used.
        """
        config = checks.settings_or_default(config, IncrementalConfig, ConfigError)
        up_world = checks.direction("up_world", up_world, ObservationError)
        builder = ObjectBuilder(config.graph, up_world, floor)
        if not isinstance(smoother, (gtsam.ISAM2, gtsam.IncrementalFixedLagSmoother)):
            raise ConfigError(f"a {type(smoother).__name__} is no smoother: ISAM2 is one")
        self._staged = StagedSmoother(smoother)
        system = IncrementalSystem(config, builder, self._staged, body_T_camera)
        self._tracker = FrontEnd(system, find_prior, object_keys)
        self._seen: list[TrackedObject] = []

    @property
    def objects(self) -> list[TrackedObject]:
        """The objects of the map; their `keys` are those of the smoother's variables."""
        return self._tracker.objects

    @property
    def pending(self) -> tuple[str, ...]:
        """Objects that were seen but not yet often enough."""
        return self._tracker.pending

    @property
    def builder(self) -> ObjectBuilder:
        """It knows where up and the floor are."""
        return self._tracker.builder

    def state(self, entry: TrackedObject) -> ObjectState:
        """The object's estimate in the smoother."""
        return self._tracker.state(entry)

    def views(self, entry: TrackedObject) -> list[ObjectView]:
        """What the object was seen in, each from where its camera is now; with a lag, not those past it."""
        return self._tracker.views(entry)

    def marginals(self, entry: TrackedObject) -> ObjectCovariance:
        """The object's joint covariance of pose, log-scale and code."""
        return self._tracker.marginals(entry)

    @torch_threads(1)
    def step(self, frame: Frame, detections: Sequence[Instance], *, camera: int) -> Step:
        """What the frame's masks show, as changes to the smoother; `camera` is the key of its pose there.

        The pose that counts is the smoother's, not the frame's. Observations that the last update has made stale are
        linearised anew.

        Raises:
            ObservationError: two detections have one id.
            SolveError: the camera is not in the smoother, or the last step's factors have no slots yet; nothing has been
                changed.
        """
        detections = checked(frame, detections)
        camera = checks.key(f"frame {frame.name}: camera", camera, SolveError)
        self._staged.check_accepted()
        if camera in self._tracker.cameras:
            raise SolveError(f"frame {frame.name}: its camera has been given with an earlier frame already")
        motion = known_already(camera, self._staged.pose(camera))
        reasons = self._tracker.keep_current(self._seen, everything=True)
        sightings = self._tracker.sightings(frame, detections, motion)
        self._tracker.take_in(frame, camera, motion, sightings.seen)
        entered, why = self._tracker.wait(sightings, camera)
        self._seen = [entry for entry, _ in sightings.seen if entry in self.objects]
        names = tuple(entry.name for entry in self._seen)
        report = FrameReport(
            frame.name, camera, names, tuple(entered), self.pending, (*reasons, *sightings.reasons, *why)
        )
        alive = tuple(key for entry in self.objects for key in entry.keys)
        return Step(*self._staged.hand_over(), alive, report)

    def accept(self, slots: Sequence[int]) -> None:
        """Say where the smoother has put the last step's factors, in their order.

        Raises:
            SolveError: there are not as many as the step has.
        """
        self._staged.accept(checks.keys("slots", slots, SolveError))
