"""The incremental map itself: cameras and tracked objects in one smoother, and how they enter and merge."""

from collections.abc import Iterable, Sequence
from copy import copy

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.keys import readable_key
from factors.state import ObjectState
from objgraph.errors import ObjectGraphError, ObservationError, SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.handle import Sighting
from objgraph.graph.object_graph import ObjectGraph
from objgraph.observation.sampling import ObjectView
from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.local import at_optimum, settled, solved
from objgraph.slam.incremental.smoother import Smoother
from objgraph.slam.incremental.staged import StagedSmoother
from objgraph.slam.incremental.tracked import (
    Observation,
    TrackedObject,
    entered,
    freeze,
    linearize,
    linearize_frozen,
)

Placed = tuple[int, ObjectView]
"""A camera's key, and a view from there."""


class IncrementalSystem:
    """Each observation is in the smoother as the quadratic of its two factors about a linearisation point."""

    def __init__(
        self,
        config: IncrementalConfig,
        builder: ObjectBuilder,
        smoother: Smoother | StagedSmoother,
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> None:
        self.config, self.builder, self.smoother = config, builder, smoother
        if body_T_camera is not None:
            checks.pose("body_T_camera", body_T_camera, ObservationError)
        self.body_T_camera = body_T_camera
        self.objects: list[TrackedObject] = []
        self.cameras: dict[int, str] = {}
        """Keys, oldest first, and the names of their frames."""
        self._others: list[gtsam.NonlinearFactor] = []

    @property
    def slope(self) -> float:
        """Occupancy slope at which observations are linearised, 1/metres."""
        return self.config.tracking.slopes[-1]

    def pose(self, key: int) -> gtsam.Pose3:
        return self.smoother.pose(key)

    def camera_pose(self, key: int) -> gtsam.Pose3:
        """T_world_camera, be the variable the camera's pose or that of the body it is fixed on."""
        return self.on_body(self.pose(key))

    def on_body(self, T_world_body: gtsam.Pose3) -> gtsam.Pose3:
        """T_world_camera of a camera on the body."""
        return T_world_body if self.body_T_camera is None else T_world_body.compose(self.body_T_camera)

    def body_of(self, T_world_camera: gtsam.Pose3) -> gtsam.Pose3:
        """The pose that is the variable."""
        if self.body_T_camera is None:
            return T_world_camera
        return T_world_camera.compose(self.body_T_camera.inverse())

    def of_camera(self, joint: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
        """A joint covariance whose last 6 rows are of the variable, in the tangent of the camera's own pose."""
        if self.body_T_camera is None:
            return joint
        carry = np.eye(len(joint))
        carry[-6:, -6:] = self.body_T_camera.inverse().AdjointMap()
        return carry @ joint @ carry.T

    def state(self, entry: TrackedObject) -> ObjectState:
        keys, smoother = entry.keys, self.smoother
        return ObjectState(
            smoother.pose(keys.pose), smoother.vector(keys.log_scale), smoother.vector(keys.code)
        )

    def held(self, entry: TrackedObject) -> list[Placed]:
        """The object's views whose cameras are in the smoother still."""
        return [(camera, view) for camera, view in entry.placed_views if self.smoother.has(camera)]

    def observations(self, entry: TrackedObject, placed: Iterable[Placed]) -> list[Observation]:
        """New observations of an object, not yet in the smoother."""
        return [
            Observation(self.builder.view(entry.prior, entry.keys, view, camera, self.body_T_camera), view)
            for camera, view in placed
        ]

    def unseen(self, entry: TrackedObject) -> list[Observation]:
        """What is known of a new object beside its views: of its box, and of the floor where that is known."""
        box = self.builder.box(entry.prior, entry.keys)
        standing = self.builder.standing(entry.prior, entry.keys)
        return [
            *(Observation([factor], None, of_prior=True) for factor in box),
            *(Observation([factor], None) for factor in standing),
        ]

    def solved(
        self,
        entries: Sequence[TrackedObject],
        cameras: Sequence[int],
        observations: Sequence[Observation],
        values: gtsam.Values,
        factors: Sequence[gtsam.NonlinearFactor] = (),
    ) -> gtsam.Values:
        """Objects and cameras by what the map says of them and by observations that it does not hold yet.

        `values` has the variables that are not in the map, `factors` what is known of those. Raises SolveError.
        """
        name = ", ".join(entry.name for entry in entries)
        keys = [*cameras, *(key for entry in entries for key in entry.keys)]
        known = [*self.smoother.marginal_factors(keys), *factors]
        start = gtsam.Values(values)
        start.insert(self.estimates(entries, cameras))
        return solved(name, known, observations, start, self.config).values

    def add_frame(
        self,
        camera: int,
        name: str,
        factors: Sequence[gtsam.NonlinearFactor],
        values: gtsam.Values,
        seen: Sequence[tuple[TrackedObject, Observation]],
        at: gtsam.Values,
    ) -> None:
        """A camera, the plain factors and variables that come with it, and its observations, linearised at `at`.

        Raises:
            SolveError: nothing has been changed.
        """
        observations = [observation for _, observation in seen]
        quadratics = linearize(observations, at, self.slope)
        numbers = self.commit([*factors, *quadratics], values, newest=camera)
        self.cameras[camera] = name
        if self.config.lag is None:  # for `batch`, which there is none of with a lag
            self._others += factors
        entered(observations, quadratics, numbers[len(factors) :], at)
        for entry, observation in seen:
            entry.observations.append(observation)
            entry.views += 1

    def add_object(self, entry: TrackedObject, state: ObjectState, placed: Sequence[Placed]) -> None:
        """An object with its priors and its views, from cameras of the map.

        It is solved against the map before it enters, beginning at `state`: the smoother's own steps have no damping.

        Raises:
            SolveError: it has no optimum near `state`, or the smoother fails; nothing has been changed.
        """
        self.enter(entry, *self.settled_at(entry, state, placed))

    def enter(
        self,
        entry: TrackedObject,
        priors: Sequence[gtsam.NonlinearFactor],
        observations: Sequence[Observation],
        quadratics: Sequence[gtsam.LinearContainerFactor],
        at: gtsam.Values,
    ) -> None:
        """An object that is solved already, with its observations' quadratics at `at`, which also has its variables.

        Raises:
            SolveError: nothing has been changed.
        """
        numbers = self.commit([*priors, *quadratics], at.extract(gtsam.KeyVector([*entry.keys])))
        entry.numbers = numbers[: len(priors)]
        entered(observations, quadratics, numbers[len(priors) :], at)
        entry.observations = [*observations]
        entry.views = entry.views_solved = len(entry.placed_views)
        self.objects.append(entry)

    def adopt(
        self, entry: TrackedObject, placed: Sequence[Placed], instead_of: TrackedObject | None = None
    ) -> None:
        """Views that turn out to be of this object; with `instead_of`, another one leaves the map for it.

        What views of that one that are past the lag have said of cameras stays in the smoother.

        Raises:
            SolveError: nothing has been changed; a factor of the caller's is on the object that would leave, for instance.
        """
        if instead_of is not None:
            self.check_free(instead_of)
        observations = self.observations(entry, placed)
        cameras = sorted({camera for camera, _ in placed})
        at = self.solved([entry], cameras, observations, gtsam.Values())
        remove = [] if instead_of is None else self._to_remove(instead_of)
        quadratics = linearize(observations, at, self.slope)
        entered(observations, quadratics, self.commit(quadratics, remove=remove), at)
        entry.observations += observations
        entry.views += len(placed) if instead_of is None else instead_of.views
        if instead_of is not None:
            self.objects.remove(instead_of)

    def solve_whole(self, rounds: int) -> None:
        """Solve everything nonlinearly, all observations' samples drawn anew in every round, and linearise it all there.

        Raises:
            SolveError: nothing has been changed.
        """
        assert isinstance(self.smoother, Smoother)  # a caller's own is his to solve
        if not self.cameras:
            return
        for entry in self.objects:
            self.prune(entry)
        observations = [observation for entry in self.objects for observation in entry.observations]
        others = self.smoother.factors_without({observation.number for observation in observations})
        values, before = self.smoother.estimate(), [(o.quadratic, o.point) for o in observations]
        try:
            for _ in range(rounds):
                freeze(observations, values, self.slope)
                values = at_optimum("the map", others, observations, values)
            self.replace(observations, linearize_frozen(observations, values), values)
            self.smoother.settle()
        except ObjectGraphError:
            self.take_back(observations, before)
            raise

    def commit(
        self,
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
        newest: int | None = None,
        remove: Sequence[int] = (),
    ) -> list[int]:
        """One step of the smoother; with a lag, objects live on, what is new, and what has new factors unless it is a camera.

        Raises:
            SolveError: nothing has been changed.
        """
        times = {}
        if self.config.lag is not None:
            # a camera that is new is the next frame's; otherwise it is still the last frame's turn
            now = float(len(self.cameras) - (newest is None))
            times = {key: now for entry in self.objects for key in entry.keys}
            times |= {} if values is None else dict.fromkeys(values.keys(), now)
            # a variable of the caller's lives on while factors come for it; cameras do not
            touched = set[int]().union(*(factor.keys() for factor in factors)) - self.cameras.keys()
            times |= {key: now for key in touched if self.smoother.has(key)}
        if newest is None and self.cameras:
            newest = next(reversed(self.cameras))
        return self.smoother.update(factors, values, remove=remove, newest=newest, times=times)

    def estimates(self, entries: Sequence[TrackedObject], cameras: Iterable[int]) -> gtsam.Values:
        """Where these objects and cameras are now."""
        values = gtsam.Values()
        for camera in cameras:
            values.insert(camera, self.pose(camera))
        for entry in entries:
            self.state(entry).insert(values, entry.keys)
        return values

    def batch(self) -> ObjectGraph:
        """The map as one nonlinear graph of its own, at the current estimate and frozen as the map is.

        Raises:
            SolveError: cameras were marginalised out behind a lag; what they said is in no nonlinear factor any more.
        """
        if self.config.lag is not None:
            raise SolveError(
                "a map with a lag has no batch graph: build it without one (IncrementalConfig.lag)"
            )
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in self._others:
            graph.push_back(factor)
        assert isinstance(self.smoother, Smoother)
        keys = set[int]().union(*(factor.keys() for factor in self._others))
        keys -= {key for entry in self.objects for key in entry.keys}
        values.insert(self.smoother.estimate().extract(gtsam.KeyVector(sorted(keys))))
        up_world, floor = self.builder.up_world, self.builder.floor
        objects = ObjectGraph(graph, values, self.config.graph, up_world=up_world, floor=floor)
        for entry in self.objects:
            handle = objects.add_object(entry.prior, self.state(entry), keys=entry.keys, name=entry.name)
            handle.other_headings = entry.other_headings
            handle.sightings += [Sighting(view, at, self.body_T_camera) for at, view in entry.placed_views]
            for observation in entry.observations:
                if not observation.of_prior:
                    # later updates freeze the map's own anew
                    objects.add_factors(handle, [copy(factor) for factor in observation.factors])
        return objects

    def settled_at(
        self, entry: TrackedObject, state: ObjectState, placed: Sequence[Placed]
    ) -> tuple[
        list[gtsam.NonlinearFactor], list[Observation], list[gtsam.LinearContainerFactor], gtsam.Values
    ]:
        """Priors, observations and their quadratics of an object that begins at `state`, and where it and its cameras then
        are; raises SolveError where it has no optimum near."""
        observations = [*self.observations(entry, placed), *self.unseen(entry)]
        cameras = sorted({camera for camera, _ in placed})
        start = self.estimates([], cameras)
        state.insert(start, entry.keys)
        priors = self.builder.priors(entry.prior, entry.keys)
        known = [*self.smoother.marginal_factors(cameras), *priors]
        problem = solved(entry.name, known, observations, start, self.config)
        freeze(observations, problem.values, self.slope)
        at = settled(problem, priors, observations, entry)
        return priors, observations, linearize_frozen(observations, at), at

    def take_back(
        self,
        observations: Sequence[Observation],
        before: Sequence[tuple[gtsam.LinearContainerFactor | None, gtsam.Values]],
    ) -> None:
        """The observations as they were with these quadratics, made at these points; raises SolveError."""
        quadratics = [quadratic for quadratic, _ in before if quadratic is not None]
        if any(o.quadratic is not quadratic for o, quadratic in zip(observations, quadratics, strict=True)):
            numbers = self.commit(quadratics, remove=[observation.number for observation in observations])
            for observation, (quadratic, point), number in zip(observations, before, numbers, strict=True):
                observation.quadratic, observation.point, observation.number = quadratic, point, number
        for observation in observations:
            freeze([observation], observation.point, self.slope)

    def _to_remove(self, entry: TrackedObject) -> list[int]:
        """Numbers of the factors that go with the object: not its priors where what the lag has left of lost views stays, which
        alone does not determine it."""
        if self.keeps_lost_views(entry):
            return [
                observation.number for observation in entry.observations if observation.camera is not None
            ]
        return self.numbers_of(entry)

    def keeps_lost_views(self, entry: TrackedObject) -> bool:
        """Whether the smoother has what views of the object said that it does not hold any more: a lag leaves that, a caller who
        takes a camera out with its factors does not."""
        return any(self._is_of_lag(entry, factor) for factor in self._others_on(entry))

    def check_free(self, entry: TrackedObject) -> None:
        """Raise SolveError where a factor of the caller's is on the object: it would be lost with the object's variables."""
        for factor in self._others_on(entry):
            if not self._is_of_lag(entry, factor):
                names = ", ".join(map(readable_key, factor.keys()))
                raise SolveError(f"{entry.name} stays as it is: a factor of yours on {names} holds it")

    def _others_on(self, entry: TrackedObject) -> list[gtsam.NonlinearFactor]:
        """Factors on the object that are none of its own."""
        self.prune(entry)
        own, others = set(entry.keys), self.smoother.factors_without(self.numbers_of(entry))
        return [factor for factor in others if own.intersection(factor.keys())]

    @staticmethod
    def _is_of_lag(entry: TrackedObject, factor: gtsam.NonlinearFactor) -> bool:
        """Whether the lag has made a factor, which is none of the object's own, of views of it."""
        return entry.has_lost_views and isinstance(factor, gtsam.LinearContainerFactor)

    def numbers_of(self, entry: TrackedObject) -> list[int]:
        """Of all factors on the object."""
        numbers = [*entry.numbers, *(observation.number for observation in entry.observations)]
        return [number for number in numbers if self.smoother.holds(number)]

    def prune(self, entry: TrackedObject) -> None:
        """Forget observations whose camera is past the lag: what they said is in the smoother for good."""
        entry.observations = [o for o in entry.observations if self.smoother.holds(o.number)]

    def replace(
        self,
        observations: Sequence[Observation],
        quadratics: Sequence[gtsam.LinearContainerFactor],
        values: gtsam.Values,
    ) -> None:
        """Put new quadratics, made at `values`, in the place of those that the observations have; raises SolveError."""
        numbers = self.commit(quadratics, remove=[observation.number for observation in observations])
        entered(observations, quadratics, numbers, values)
