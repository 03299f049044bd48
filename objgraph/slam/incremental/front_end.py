"""What is the same whoever owns the smoother: which detections are which objects, what enters, what is renewed."""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import ConfigError, ObjectGraphError, ObservationError, PriorError
from objgraph.graph.builder import ObjectBuilder
from objgraph.observation.frames import Frame, Instance
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.association import Detection, MappedCandidate, associate, duplicates
from objgraph.slam.incremental.alone import Alone
from objgraph.slam.incremental.motion import Motion, joint_with_last_camera
from objgraph.slam.incremental.pending import PendingObject
from objgraph.slam.incremental.places import Places
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject, twice
from objgraph.slam.incremental.upkeep import Upkeep

_LOG = logging.getLogger(__name__)
VIEWS_ENOUGH = 9
"""Of an object that is in doubt: then it enters as it is, to be solved again as the map's objects are."""
_NEARBY = 4.0
"""Metres between a detection's points and an object's centre beyond which they are never compared."""


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
        self._find_prior, self._object_keys = find_prior, object_keys
        self._pending: list[PendingObject] = []
        self._centres = Places[TrackedObject]()
        self._started = 0
        self._turn = 0

    @property
    def objects(self) -> list[TrackedObject]:
        """The objects of the map."""
        return self.system.objects

    @property
    def cameras(self) -> dict[int, str]:
        """Keys of the cameras, oldest first, and the names of their frames."""
        return self.system.cameras

    @property
    def pending(self) -> tuple[str, ...]:
        """Objects that were seen but not yet often enough."""
        return tuple(entry.name for entry in self._pending)

    def state(self, entry: TrackedObject) -> ObjectState:
        """The object's current estimate."""
        return self.system.state(entry)

    @property
    def builder(self) -> ObjectBuilder:
        """It knows where up and the floor are."""
        return self.system.builder

    def views(self, entry: TrackedObject) -> list[ObjectView]:
        """What the object was seen in, each from where its camera is now; with a lag, not those past it."""
        return [view.at(self.system.camera_pose(camera)) for camera, view in self._held(entry)]

    def pose(self, camera: int) -> gtsam.Pose3:
        """T_world_camera, or T_world_body where there is a `body_T_camera`, as it is estimated now.

        Raises:
            SolveError: it is not in the map, or past its lag, or no pose.
        """
        return self.system.pose(camera)

    def marginals(self, entry: TrackedObject) -> ObjectCovariance:
        """The object's joint covariance of pose, log-scale and code."""
        return ObjectCovariance.of(self.joint_marginals(entry), "marginals")

    def joint_marginals(self, entry: TrackedObject, others: Sequence[int] = ()) -> Float[np.ndarray, "d d"]:
        """Joint covariance of the object's pose, log-scale and code and then of `others`, keys such as cameras'."""
        return self.system.smoother.covariance([*entry.keys, *others])

    def sightings(self, frame: Frame, detections: Sequence[Instance], motion: Motion) -> Sightings:
        T_world_camera = self.system.on_body(motion.predicted)
        self._follow()
        views, reasons = self._views(frame, detections, T_world_camera)
        known = [*self._near(views), *(entry for entry in self._pending if entry.views)]
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
                prior = self._find_prior(detection.category)
                views.append(
                    (view.at(T_world_camera), checks.instance("a prior", prior, ShapePrior, PriorError))
                )
            except ObjectGraphError as error:
                reasons.append(str(error))
                _LOG.info("a detection is left out: %s", error)
        return views, reasons

    def _near(self, views: Sequence[tuple[ObjectView, ShapePrior]]) -> list[TrackedObject]:
        """Objects that a frame's detections may be of, by where they were last seen to be."""
        if not views or not self.objects:
            return []
        seen = np.array([view.points_world.mean(axis=0) for view, _ in views])
        return self._centres.near(seen, _NEARBY)

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
            reasons += self._begin(view, prior, camera)
        entered, why = self._admit()
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
            if again is not None and self.upkeep.resolve(again, self._next_keys):
                reasons.append(f"{again.name} has turned: its {again.views} views say so")
            self.upkeep.renew(due, self.config.tolerance, self.config.refreshes)
        except ObjectGraphError as error:
            reasons.append(f"upkeep is left for the next frame: {error}")
            _LOG.warning("%s", reasons[-1])
        self._note_centres(self.objects if everything else due)
        return reasons

    def _let_go(self) -> list[str]:
        """Let objects leave whose variables the caller's smoother has lost, for instance to its lag; which, and why."""
        smoother, reasons = self.system.smoother, []
        for entry in [*self.objects]:
            if not all(smoother.has(key) for key in entry.keys):
                self.objects[:] = [each for each in self.objects if each is not entry]
                self._centres.remove(entry.name)
                reasons.append(f"{entry.name} has left: its variables are not in your smoother any more")
                _LOG.warning("%s", reasons[-1])
        return reasons

    def _note_centres(self, entries: Sequence[TrackedObject]) -> None:
        for entry in entries:
            self._centres.put(entry.name, entry, self.pose(entry.keys.pose).translation())

    def _begin(self, view: ObjectView, prior: ShapePrior, camera: int) -> list[str]:
        """Start an object that waits for more views; why not, if it cannot be."""
        index, number = self._started, len(self.cameras) - 1
        name = f"{prior.category} {index}"
        T_world_camera = self.system.camera_pose(camera)
        placed = view.at(T_world_camera)
        system = self.system
        try:
            estimate = Alone(name, prior, [placed], system.builder, self.config).rough()
        except ObjectGraphError as error:
            return [f"{name} is not started: {error}"]
        self._started += 1
        self._pending.append(
            PendingObject(index, name, prior, estimate, number, [(camera, view)], {camera: T_world_camera})
        )
        return []

    def _admit(self) -> tuple[list[str], list[str]]:
        """Let in the pending objects that are ripe, give up those not seen for long: names, and reasons."""
        entered, reasons, waiting = [], [], []
        self._follow()
        for entry in self._pending:
            if entry.views and entry.is_ripe(self.config):
                try:
                    if (doubt := self._doubt(entry)) is not None:
                        reasons.append(doubt)
                        waiting.append(entry)
                        continue
                    reasons += self._enter(entry)
                    entered += [entry.name] if entry.name in self._centres else []
                except ObjectGraphError as error:
                    reasons.append(f"{entry.name} does not enter: {error}")
            elif not entry.views or len(self.cameras) - entry.last_seen > self.config.patience:
                unseen = f"not seen again for {self.config.patience} frames"
                why = unseen if entry.views else "the cameras that saw it are past the lag"
                reasons.append(f"{entry.name} is given up: {why}")
            else:
                waiting.append(entry)
        self._pending = waiting
        return entered, reasons

    def _follow(self) -> None:
        for entry in self._pending:
            held = [key for key, _ in entry.views if self.system.smoother.has(key)]
            entry.follow({key: self.system.camera_pose(key) for key in held})

    def _doubt(self, pending: PendingObject) -> str | None:
        """Solve a ripe object alone, and say why it waits for more views; None where it may enter."""
        views = [view.at(pending.cameras[key]) for key, view in pending.views]
        alone = Alone(pending.name, pending.prior, views, self.system.builder, self.config)
        pending.estimate = alone.first()
        trust = None if pending.sightings >= VIEWS_ENOUGH else alone.trust(pending.estimate)
        if trust is None or not trust.is_poor:
            return None
        pending.awaited = twice(pending.sightings)
        return f"{pending.name} waits for {pending.awaited} views: its pose is right with {trust.percent} %"

    def _enter(self, pending: PendingObject) -> list[str]:
        """Enter a ripe object, or its views where it is one that the map has already."""
        system = self.system
        views = [view.at(pending.cameras[key]) for key, view in pending.views]
        near = self._near([(view, pending.prior) for view in views])
        doubles = duplicates(
            [pending.candidate(), *(self._alone(entry) for entry in near)], self.config.association
        )
        for merge in doubles:
            if 0 in (merge.keep, merge.drop):
                known = near[max(merge.keep, merge.drop) - 1]
                system.adopt(known, pending.views)
                shares = f"d2 {merge.mahalanobis**2:.1f} in 3 directions, surfaces {merge.overlap:.2f}"
                return [f"{pending.name} is {known.name}, which the map has already: {shares}"]
        keys, turns = self._keys(pending.index), pending.estimate.turns
        entry = TrackedObject(pending.name, keys, pending.prior, other_headings=turns)
        system.add_object(entry, pending.estimate.state, pending.views)
        self._note_centres([entry])
        try:
            return self._merge([entry, *near])
        except ObjectGraphError as error:  # the object is in the map by now
            _LOG.warning("%s is not merged with its neighbours: %s", entry.name, error)
            return [f"{entry.name} is not merged with its neighbours: {error}"]

    def _next_keys(self) -> ObjectKeys:
        self._started += 1
        return self._keys(self._started - 1)

    def _keys(self, index: int) -> ObjectKeys:
        """Of the object of this number; raises ConfigError where the caller's function fails or gives something else."""
        what = f"object_keys({index})"
        try:
            keys = self._object_keys(index)
        except ObjectGraphError:
            raise
        except Exception as error:  # the caller's, whatever it is: the frame is in the map by now
            raise ConfigError(f"{what} failed: {error!r}") from error
        return checks.instance(what, keys, ObjectKeys, ConfigError)

    def _merge(self, entries: Sequence[TrackedObject]) -> list[str]:
        """Where the map has one thing twice, give its views to the one that is better known."""
        reasons = []
        for merge in duplicates([self._alone(entry) for entry in entries], self.config.association):
            keep, drop = entries[merge.keep], entries[merge.drop]
            try:
                self.system.adopt(keep, self._held(drop), instead_of=drop)
            except ObjectGraphError as error:
                reasons.append(f"{drop.name} is not merged with {keep.name}: {error}")
                _LOG.warning("%s", reasons[-1])
                continue
            self._centres.remove(drop.name)
            reasons.append(merge.reason)
        return reasons

    def _held(self, entry: TrackedObject) -> list[tuple[int, ObjectView]]:
        """Views from cameras that are in the smoother still."""
        return [(camera, view) for camera, view in entry.placed_views if self.system.smoother.has(camera)]

    def _alone(self, entry: TrackedObject) -> MappedCandidate:
        return entry.candidate(self.state(entry), lambda: self.joint_marginals(entry))
