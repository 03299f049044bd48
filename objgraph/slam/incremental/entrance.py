"""What is seen but not in the map yet: it waits, enters, or turns out to be what the map has already."""

import logging
from collections.abc import Callable, Sequence

from factors import checks
from factors.state import ObjectKeys
from objgraph.errors import ConfigError, ObjectGraphError
from objgraph.graph.solve import FAILURES
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior
from objgraph.slam.association import MappedCandidate, duplicates
from objgraph.slam.incremental.alone import Alone
from objgraph.slam.incremental.pending import PendingObject
from objgraph.slam.incremental.places import ObjectPlaces
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject

_LOG = logging.getLogger(__name__)
VIEWS_ENOUGH = 9
"""Of an object that is in doubt: then it enters as it is, to be solved again as the map's objects are."""
_VIEWS_AWAITED = (5, VIEWS_ENOUGH)
"""Views of an object in doubt at which it is solved again."""


class Entrance:
    """Where objects wait until they have been seen often enough."""

    def __init__(
        self, system: IncrementalSystem, places: ObjectPlaces, object_keys: Callable[[int], ObjectKeys]
    ) -> None:
        self._system, self._places, self._object_keys = system, places, object_keys
        self.waiting: list[PendingObject] = []
        self._started = 0

    def begin(self, view: ObjectView, prior: ShapePrior, camera: int) -> list[str]:
        """Start an object that waits for more views; why not, if it cannot be."""
        index, number = self._started, len(self._system.cameras) - 1
        name, system = f"{prior.category} {index}", self._system
        T_world_camera = system.camera_pose(camera)
        placed = view.at(T_world_camera)
        try:
            estimate = Alone(name, prior, [placed], system.builder, system.config).rough()
        except FAILURES as error:
            return [f"{name} is not started: {error}"]
        self._started += 1
        self.waiting.append(
            PendingObject(index, name, prior, estimate, number, [(camera, view)], {camera: T_world_camera})
        )
        return []

    def admit(self) -> tuple[list[str], list[str]]:
        """Let in the pending objects that are ripe, give up those not seen for long: names, and reasons."""
        entered, reasons, waiting = [], [], []
        config, frames = self._system.config, len(self._system.cameras)
        self.follow()
        for entry in self.waiting:
            if entry.views and entry.is_ripe(config):
                try:
                    if (doubt := self._doubt(entry)) is not None:
                        reasons.append(doubt)
                        waiting.append(entry)
                        continue
                    reasons += self._enter(entry)
                    entered += [entry.name] if entry.name in self._places else []
                except FAILURES as error:
                    reasons.append(f"{entry.name} does not enter: {error}")
            elif not entry.views or frames - entry.last_seen > config.patience:
                unseen = f"not seen again for {config.patience} frames"
                why = unseen if entry.views else "the cameras that saw it are past the lag"
                reasons.append(f"{entry.name} is given up: {why}")
            else:
                waiting.append(entry)
        self.waiting = waiting
        return entered, reasons

    def follow(self) -> None:
        """Go along with the cameras, which the map may have moved or, with a lag, forgotten."""
        for entry in self.waiting:
            held = [key for key, _ in entry.views if self._system.smoother.has(key)]
            entry.follow({key: self._system.camera_pose(key) for key in held})

    def _doubt(self, pending: PendingObject) -> str | None:
        """Solve a ripe object alone, and say why it waits for more views; None where it may enter."""
        views = [view.at(pending.cameras[key]) for key, view in pending.views]
        alone = Alone(pending.name, pending.prior, views, self._system.builder, self._system.config)
        pending.estimate = alone.first()
        trust = None if pending.sightings >= VIEWS_ENOUGH else alone.trust(pending.estimate)
        if trust is None or not trust.is_poor:
            return None
        pending.awaited = next(views for views in _VIEWS_AWAITED if views > pending.sightings)
        return f"{pending.name} waits for {pending.awaited} views: its pose is right with {trust.percent} %"

    def _enter(self, pending: PendingObject) -> list[str]:
        """Enter a ripe object, or its views where it is one that the map has already."""
        system, config = self._system, self._system.config.association
        views = [view.at(pending.cameras[key]) for key, view in pending.views]
        near = self._places.of(views)
        doubles = duplicates([pending.candidate(), *(self._alone(entry) for entry in near)], config)
        for merge in doubles:
            if 0 in (merge.keep, merge.drop):
                known = near[max(merge.keep, merge.drop) - 1]
                system.adopt(known, pending.views)
                shares = f"d2 {merge.mahalanobis**2:.1f} in 3 directions, surfaces {merge.overlap:.2f}"
                return [f"{pending.name} is {known.name}, which the map has already: {shares}"]
        keys, turns = self._keys(pending.index), pending.estimate.turns
        entry = TrackedObject(pending.name, keys, pending.prior, other_headings=turns)
        system.add_object(entry, pending.estimate.state, pending.views)
        self._places.note([entry])
        try:
            return self.merge([entry, *near])
        except FAILURES as error:  # the object is in the map by now
            _LOG.warning("%s is not merged with its neighbours: %s", entry.name, error)
            return [f"{entry.name} is not merged with its neighbours: {error}"]

    def next_keys(self) -> ObjectKeys:
        """Those of another object."""
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

    def merge(self, entries: Sequence[TrackedObject]) -> list[str]:
        """Where the map has one thing twice, give its views to the one that is better known."""
        reasons = []
        for merge in duplicates([self._alone(entry) for entry in entries], self._system.config.association):
            keep, drop = entries[merge.keep], entries[merge.drop]
            try:
                self._system.adopt(keep, self._system.held(drop), instead_of=drop)
            except FAILURES as error:
                reasons.append(f"{drop.name} is not merged with {keep.name}: {error}")
                _LOG.warning("%s", reasons[-1])
                continue
            self._places.remove(drop.name)
            reasons.append(merge.reason)
        return reasons

    def _alone(self, entry: TrackedObject) -> MappedCandidate:
        return entry.candidate(
            self._system.state(entry), lambda: self._system.smoother.covariance([*entry.keys])
        )
