"""What is the same whoever owns the smoother: which detections are which objects, what a frame says, what is renewed."""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.keys import readable_key
from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import ConfigError, ObjectGraphError, ObservationError, PriorError, SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import FAILURES
from objgraph.observation.frames import Frame, Instance
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.association import Detection, MappedCandidate, associate
from objgraph.slam.incremental.entrance import Entrance
from objgraph.slam.incremental.motion import Motion, joint_with_last_camera
from objgraph.slam.incremental.pending import PendingObject
from objgraph.slam.incremental.places import ObjectPlaces
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject
from objgraph.slam.incremental.upkeep import Upkeep

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class FrameReport:
    """What one update did."""

    frame: str
    camera: int
    """The camera's key."""
    seen: tuple[str, ...]
    """Objects of the map that the frame observed."""
    entered: tuple[str, ...]
    """Objects that entered the map with this frame."""
    pending: tuple[str, ...]
    """Objects that wait for more views."""
    reasons: tuple[str, ...]
    """One line for each decision, and for whatever could not be used."""


@dataclass(frozen=True)
class Sightings:
    """A frame's detections, told apart."""

    seen: list[tuple[TrackedObject, ObjectView]]
    """Of the map's objects."""
    again: list[tuple[PendingObject, ObjectView]]
    """Of objects that wait for more views."""
    new: list[tuple[ObjectView, ShapePrior]]
    reasons: list[str]


def checked(frame: Frame, detections: Sequence[Instance]) -> tuple[Instance, ...]:
    """A frame's detections; raises ObservationError where one of them or the frame is none, or two are of one mask."""
    checks.instance("frame", frame, Frame, ObservationError)
    where = f"frame {frame.name}: detections"
    detections = checks.tuple_of(where, detections, Instance, ObservationError)
    for detection, count in Counter(each.id for each in detections).items():
        if count > 1:  # every pixel of it would count as often
            raise ObservationError(f"{where} name object {detection} {count} times: name each mask once")
    return detections


class FrontEnd:
    """Objects that are seen frame by frame; subclasses say whose smoother they are in."""

    def __init__(
        self,
        system: IncrementalSystem,
        find_prior: Callable[[str], ShapePrior],
        object_keys: Callable[[int], ObjectKeys],
    ) -> None:
        if not callable(find_prior) or not callable(object_keys):
            raise ConfigError("find_prior and object_keys must be functions, of a category and of a number")
        self.system, self.config, self.upkeep = system, system.config, Upkeep(system)
        self.places = ObjectPlaces(system)
        self.entrance = Entrance(system, self.places, object_keys)
        self._find_prior = find_prior
        self._turn = 0

    @property
    def objects(self) -> list[TrackedObject]:
        """The objects of the map."""
        return self.system.objects

    @property
    def cameras(self) -> dict[int, str]:
        """Keys of the cameras, oldest first, and the names of their frames; with a lag, those past it too."""
        return self.system.cameras

    @property
    def pending(self) -> tuple[str, ...]:
        """Objects that were seen but not yet often enough."""
        return tuple(entry.name for entry in self.entrance.waiting)

    def state(self, entry: TrackedObject) -> ObjectState:
        """The object's current estimate."""
        return self.system.state(entry)

    @property
    def builder(self) -> ObjectBuilder:
        """It knows where up and the floor are."""
        return self.system.builder

    def views(self, entry: TrackedObject) -> list[ObjectView]:
        """What the object was seen in, each from where its camera is now; with a lag, not those past it."""
        return [view.at(self.system.camera_pose(camera)) for camera, view in self.system.held(entry)]

    def pose(self, camera: int) -> gtsam.Pose3:
        """T_world_camera, or T_world_body where there is a `body_T_camera`, as it is estimated now.

        Raises:
            SolveError: it is no key, or not in the map, or past its lag, or no pose.
        """
        return self.system.pose(checks.key("camera", camera, SolveError))

    def marginals(self, entry: TrackedObject) -> ObjectCovariance:
        """The object's joint covariance of pose, log-scale and code."""
        return ObjectCovariance.of(self.joint_marginals(entry), "marginals")

    def joint_marginals(self, entry: TrackedObject, others: Sequence[int] = ()) -> Float[np.ndarray, "d d"]:
        """Joint covariance of the object's pose, log-scale and code and then of `others`, keys such as cameras'.

        Raises:
            SolveError: one of the keys is none, is asked for twice, or is not in the map or not determined.
        """
        keys = [*entry.keys, *checks.keys(f"{entry.name}: others", others, SolveError)]
        if twice := [key for key in keys if keys.count(key) > 1]:
            raise SolveError(f"{readable_key(twice[0])} is asked for twice; name each variable once")
        return self.system.smoother.covariance(keys)

    def sightings(self, frame: Frame, detections: Sequence[Instance], motion: Motion) -> Sightings:
        T_world_camera = self.system.on_body(motion.predicted)
        self.entrance.follow()
        views, reasons = self._views(frame, detections, T_world_camera)
        waiting = [entry for entry in self.entrance.waiting if entry.views]
        known = [*self.places.of([view for view, _ in views]), *waiting]
        found = associate(
            [Detection(view, prior.category) for view, prior in views],
            [self._candidate(entry, motion) for entry in known],
            self.config.association,
            T_world_camera,
        )
        reasons += [entry.reason for entry in (*found.matches, *found.new, *found.dropped)]
        seen, again = [], []
        for match in found.matches:
            entry, (view, _) = known[match.object], views[match.detection]
            if isinstance(entry, TrackedObject):
                seen.append((entry, view))
            else:
                again.append((entry, view))
        return Sightings(seen, again, [views[new.detection] for new in found.new], reasons)

    def _views(
        self, frame: Frame, detections: Sequence[Instance], T_world_camera: gtsam.Pose3
    ) -> tuple[list[tuple[ObjectView, ShapePrior]], list[str]]:
        views, reasons = [], []
        for detection in detections:
            try:
                seed = self.config.seed + len(self.cameras)
                view = observe(frame, detection.id, self.config.sampling, seed)
                views.append((view.at(T_world_camera), self._prior(detection.category)))
            except ObjectGraphError as error:
                reasons.append(str(error))
                _LOG.info("a detection is left out: %s", error)
        return views, reasons

    def _prior(self, category: str) -> ShapePrior:
        """Raises PriorError where the caller's function fails or gives something else."""
        try:
            prior = self._find_prior(category)
        except ObjectGraphError:
            raise
        except Exception as error:  # the caller's, whatever it is: KeyError of a dict, for instance
            raise PriorError(f"find_prior({category!r}) failed: {error!r}") from error
        return checks.instance("a prior", prior, ShapePrior, PriorError)

    def _candidate(self, entry: TrackedObject | PendingObject, motion: Motion) -> MappedCandidate:
        if isinstance(entry, TrackedObject):
            return entry.candidate(
                self.state(entry),
                lambda: self.system.of_camera(
                    motion.with_camera(self.joint_marginals(entry, motion.known[-1:]))
                ),
            )
        first = entry.views[0][0]
        keys = [first, *(key for key in motion.known if key != first)]
        T_object_first = entry.estimate.state.T_world_object.between(self.pose(first))
        return entry.candidate(
            lambda own: self.system.of_camera(
                motion.with_camera(
                    joint_with_last_camera(own, T_object_first, self.system.smoother.covariance(keys))
                )
            )
        )

    def take_in(
        self,
        frame: Frame,
        camera: int,
        motion: Motion,
        seen: Sequence[tuple[TrackedObject, ObjectView]],
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
    ) -> None:
        """Solve the camera and the objects that it sees against the map, then enter what the frame says into it."""
        system, at = self.system, gtsam.Values()
        observations = [(entry, system.observations(entry, [(camera, view)])[0]) for entry, view in seen]
        added = gtsam.Values() if values is None else gtsam.Values(values)
        if camera not in motion.known:
            at.insert(camera, motion.predicted)
        if seen:
            entries, new = [entry for entry, _ in seen], [observation for _, observation in observations]
            at = system.solved(entries, motion.known, new, at, motion.factors)
        if camera not in motion.known:
            added.insert(camera, at.atPose3(camera))
        system.add_frame(camera, frame.name, [*motion.factors, *factors], added, observations, at)

    def wait(self, sightings: Sightings, camera: int) -> tuple[list[str], list[str]]:
        """Note what is not in the map yet, and let in what has been seen often enough: names, and reasons."""
        reasons = []
        for entry, view in sightings.again:
            entry.see(camera, self.system.camera_pose(camera), view, len(self.cameras) - 1)
        for view, prior in sightings.new:
            reasons += self.entrance.begin(view, prior, camera)
        entered, why = self.entrance.admit()
        return entered, [*reasons, *why]

    def keep_current(self, seen: Sequence[TrackedObject], everything: bool) -> list[str]:
        """Renew what the frame has made stale, solve one object again, and look at one other in turn; what turned, and what
        could not be renewed.

        The frame is in the map by now: an object that cannot be renewed stays linearised where it was.
        """
        reasons = self._let_go()
        seen = [entry for entry in seen if any(entry is each for each in self.objects)]
        others = [self.objects[self._turn % len(self.objects)]] if self.objects else []
        self._turn += 1
        due = list({entry.name: entry for entry in (*seen, *others)}.values())
        # one a frame, though those that are seen together fall due together
        again = min(
            (entry for entry in seen if entry.is_due), key=lambda entry: entry.views_solved, default=None
        )
        try:
            if again is not None and self.upkeep.resolve(again, self.entrance.next_keys):
                reasons.append(f"{again.name} has turned: its {again.views} views say so")
            self.upkeep.renew(due, self.config.tolerance, self.config.refreshes)
        except FAILURES as error:
            reasons.append(f"upkeep is left for the next frame: {error}")
            _LOG.warning("%s", reasons[-1])
        self.places.note(self.objects if everything else due)
        return reasons

    def _let_go(self) -> list[str]:
        """Let objects leave whose variables the caller's smoother has lost, for instance to its lag; which, and why."""
        smoother, reasons = self.system.smoother, []
        for entry in [*self.objects]:
            if not all(smoother.has(key) for key in entry.keys):
                self.objects[:] = [each for each in self.objects if each is not entry]
                self.places.remove(entry.name)
                reasons.append(f"{entry.name} has left: its variables are not in your smoother any more")
                _LOG.warning("%s", reasons[-1])
        return reasons
