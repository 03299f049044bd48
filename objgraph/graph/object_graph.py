"""Objects inside a GTSAM graph that the caller owns."""

import itertools
from collections.abc import Callable, Collection, Iterable, Sequence

import gtsam
import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from factors import checks
from factors.base import Annealing, ObservationFactor
from factors.errors import FactorError
from factors.keys import readable_key
from factors.state import ObjectKeys, ObjectState
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.posterior import Posterior
from objgraph.diagnostics.keys import is_pose
from objgraph.diagnostics.undetermined import require_values
from objgraph.errors import ConfigError, ObjectGraphError, ObservationError, PriorError, SolveError
from objgraph.graph.builder import DetectedBox, GraphConfig, ObjectBuilder
from objgraph.graph.handle import ObjectHandle, Sighting
from objgraph.graph.headings import place
from objgraph.graph.initialise import InitialisationConfig
from objgraph.graph.solve import Problem, SolverConfig, solve
from objgraph.observation.sampling import ObjectView
from objgraph.priors.registry import prior_for
from objgraph.priors.shape_prior import ShapePrior

JOINT_ROUNDS = 20
"""Of the solver, at most, where cameras and objects are unknown together."""


class ObjectGraph:
    """Adds objects, their priors and their views to the caller's graph and values; owns neither.

    What it adds it can take out again, and it touches nothing else: the caller may go on adding factors and
    variables, and use an optimiser of his own.
    """

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        config: GraphConfig | None = None,
        *,
        up_world: Float[np.ndarray, "3"] | None = None,
        floor: float | None = None,
        initialisation: InitialisationConfig | None = None,
    ) -> None:
        """`up_world` is the unit vector against gravity, `floor` the floor's height along it, where they are known."""
        self.graph = checks.instance("graph", graph, gtsam.NonlinearFactorGraph)
        self.values = checks.instance("values", values, gtsam.Values)
        config = checks.settings_or_default(config, GraphConfig, ConfigError)
        self.builder = ObjectBuilder(config, up_world, floor)
        self.initialisation = checks.settings_or_default(initialisation, InitialisationConfig, ConfigError)
        self.objects: list[ObjectHandle] = []

    def add_object(
        self,
        prior: ShapePrior | str,
        start: ObjectState | ObjectView | Sequence[ObjectView],
        *,
        box: DetectedBox | None = None,
        keys: ObjectKeys | None = None,
        name: str | None = None,
    ) -> ObjectHandle:
        """Add an object's variables and what is known beforehand of its code, its scale and, where up is known, its lean.

        `prior` is a shape prior or the name of a category. `start` is the first estimate, or views of the object
        from which to find one: each as seen from its own `T_world_camera` (`ObjectView.at` sets another). All headings that
        they leave are tried, on a part of their samples. The views add no factor of theirs: `observe` does. `box` is a detector's,
        as a measurement of place and size.

        Raises:
            FactorError: one of the keys is already in the values, the code is not of the prior's length, or the start
                stands on its head.
            PriorError: the prior is none.
            ObservationError: views are given, but not which way is up.
            InitialisationError: the views do not suffice to place the object.
        """
        prior = prior_for(prior) if isinstance(prior, str) else prior
        prior = checks.instance("prior (a ShapePrior or a category)", prior, ShapePrior, PriorError)
        name = f"{prior.category} {self._free_number()}" if name is None else checks.text("name", name)
        views = [] if isinstance(start, ObjectState) else _several(name, start)
        if isinstance(start, ObjectState):
            state, headings = start, None
        else:
            state, headings = self._placed(name, prior, views, box)
        if len(state.code) != prior.decoder.code_length:
            raise FactorError(
                f"{name}: a code of length {len(state.code)}, its decoder takes {prior.decoder.code_length}"
            )
        keys = ObjectKeys.numbered(self._free_index()) if keys is None else keys
        checks.instance(f"{name}: keys", keys, ObjectKeys)
        handle = ObjectHandle(name, keys, prior, other_headings=headings)
        state.check_finite(handle.keys)
        self.builder.check_upright(handle.keys, state)
        # all that may fail comes before the first change
        known, factors = self.builder.priors(prior, handle.keys, box), self.builder.box(prior, handle.keys)
        standing = self.builder.standing(prior, handle.keys) if views else []
        state.insert(self.values, handle.keys)
        for factor in known:
            self._push(handle, factor)
        self.objects.append(handle)
        self.add_factors(handle, [*factors, *standing])
        return handle

    def observe(
        self,
        handle: ObjectHandle,
        view: ObjectView,
        camera: gtsam.Pose3 | int | None = None,
        *,
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> None:
        """Add the 3D and the 2D factor of one view.

        `camera` is T_world_camera, or the key of a `Pose3` that holds it; by default the view's own pose. With
        `body_T_camera` it is the pose, or its key, of the body that the camera is fixed on.

        Raises:
            FactorError: the object is not in this graph, or a pose is none.
            ObservationError: the view is none, or `body_T_camera` is given, but not the body's pose.
        """
        self._check_known(handle)
        checks.instance(f"{handle.name}: view", view, ObjectView, ObservationError)
        if camera is None and body_T_camera is not None:
            raise ObservationError(
                f"{handle.name}: with body_T_camera, `camera` must be the body's pose or its key"
            )
        camera = view.T_world_camera if camera is None else camera
        factors = self.builder.view(handle.prior, handle.keys, view, camera, body_T_camera)
        begin = self.graph.size()
        self.add_factors(handle, factors)
        slots = tuple(range(begin, self.graph.size()))
        handle.sightings.append(Sighting(view, camera, body_T_camera, tuple(factors), slots))

    def add_factors(self, handle: ObjectHandle, factors: Sequence[ObservationFactor]) -> None:
        """Add observation factors on the object's keys that were made elsewhere; raises FactorError of another object's."""
        self._check_known(handle)
        for i, factor in enumerate(factors):
            what = f"{handle.name}: factors[{i}]"
            if checks.instance(what, factor, ObservationFactor).object_keys != handle.keys:
                names = ", ".join(map(readable_key, factor.object_keys))
                raise FactorError(f"{what} is of another object, {names}")
        for factor in factors:
            self._push(handle, factor.gtsam_factor())
            handle.factors.append(factor)

    def stand_on_floor(self, handle: ObjectHandle) -> None:
        """Add what the floor says: nothing of the object lies below it.

        Raises:
            ObservationError: the graph was not told where the floor is, or which way is up.
        """
        self._check_known(handle)
        standing = self.builder.standing(handle.prior, handle.keys)
        if not standing:
            raise ObservationError(
                f"{handle.name}: say where the floor is (ObjectGraph(up_world=..., floor=...))"
            )
        self.add_factors(handle, standing)

    def remove_object(self, handle: ObjectHandle) -> None:
        """Take the object's variables and factors out again; the caller's stay as they are.

        A removed factor leaves an empty slot, as `NonlinearFactorGraph.remove` does, unless it is the graph's last.

        Raises:
            FactorError: a factor of the caller's own is on one of the object's keys, or the object's factors are
                not in the graph any more; nothing has been changed.
        """
        self._check_removable(handle)
        self._take_out(handle.slots)
        for key in handle.keys:
            self.values.erase(key)
        self.objects[:] = [each for each in self.objects if each is not handle]

    def remove_view(self, handle: ObjectHandle, view: ObjectView) -> None:
        """Take the factors of a view that `observe` was given out again; the estimate stays as it is, and so does what the view
        said when the object was placed.

        Raises:
            FactorError: the object is not in this graph, was not observed in the view by this graph's `observe`, or the view's
                factors are not in the graph any more; nothing has been changed.
        """
        self._check_known(handle)
        gone = [each for each in handle.sightings if each.view is view]
        if not gone:
            raise FactorError(f"{handle.name} was not observed in this view, or it was taken out already")
        if not all(each.slots for each in gone):
            raise FactorError(
                f"{handle.name}: the view's factors came otherwise than by `observe`, which they are is not known"
            )
        slots = [slot for each in gone for slot in each.slots]
        self._check_there(handle, slots)
        self._take_out(slots)
        factors = {id(factor) for each in gone for factor in each.factors}
        for slot in slots:
            del handle.slots[slot]
        handle.factors[:] = [factor for factor in handle.factors if id(factor) not in factors]
        handle.sightings[:] = [each for each in handle.sightings if each.view is not view]

    def refresh(self, annealing: Annealing = Annealing()) -> None:  # noqa: B008
        """Freeze noise and ray samples at the current values; the caller's optimiser may then run."""
        checks.instance("annealing", annealing, Annealing)
        for handle in self.objects:
            for factor in handle.factors:
                factor.refresh(self.values, annealing)

    def optimize(
        self, config: SolverConfig | None = None, progress: Callable[[int, int], None] | None = None
    ) -> list[Problem]:
        """Minimise the whole graph, each connected part by itself; the values are updated in place.

        Cameras and objects together take more rounds than one object: by default up to `JOINT_ROUNDS`. `progress` is called with
        (rounds done, rounds at most).

        Raises:
            SolveError: a part failed, or leaves something undetermined; the message names its objects, and the
                directions and the priors that are missing. That part stays as it was, the others are updated.
        """
        config = SolverConfig(rounds=JOINT_ROUNDS) if config is None else config
        problems = self.problems()
        solve(problems, config, progress, refuse_undetermined=True)
        for problem in problems:
            if not problem.failure:
                self.values.update(problem.values)
        failed = [f"{problem.name}: {problem.failure}" for problem in problems if problem.failure]
        if failed:
            raise SolveError("; ".join(failed))
        return problems

    def problems(self) -> list[Problem]:
        """The graph's connected parts, each with the values and the decoder factors that belong to it.

        Raises:
            SolveError: a factor's variable is not in the values.
        """
        require_values(self.graph, self.values)
        factors = [self.graph.at(i) for i in range(self.graph.size()) if self._keys_at(i)]
        groups = [list(factor.keys()) for factor in factors]
        part = _parts([*groups, *(list(handle.keys) for handle in self.objects)])
        graphs: dict[int, gtsam.NonlinearFactorGraph] = {}
        for factor, keys in zip(factors, groups, strict=True):
            graphs.setdefault(part[keys[0]], gtsam.NonlinearFactorGraph()).push_back(factor)
        problems = []
        for number, graph in graphs.items():
            handles = [handle for handle in self.objects if part[handle.keys.pose] == number]
            values = self.values.extract(graph.keyVector())
            name = ", ".join(handle.name for handle in handles) or "variables without objects"
            problems.append(Problem(name, graph, values, [f for h in handles for f in h.factors]))
        return problems

    def state(self, handle: ObjectHandle) -> ObjectState:
        """The object's current estimate; raises FactorError where it is not in this graph."""
        self._check_known(handle)
        return ObjectState.from_values(self.values, handle.keys)

    def views(self, handle: ObjectHandle) -> list[ObjectView]:
        """What the object was observed in, each from where its camera is now; raises FactorError where it is not in this graph,
        or the values hold no such camera."""
        self._check_known(handle)
        found = []
        for view, camera, body_T_camera, *_ in handle.sightings:
            if not isinstance(camera, gtsam.Pose3):
                if not is_pose(camera, self.values):
                    raise FactorError(f"{handle.name}: the values hold no camera at {readable_key(camera)}")
                camera = self.values.atPose3(camera)
            found.append(view.at(camera if body_T_camera is None else camera.compose(body_T_camera)))
        return found

    def posterior(self) -> Posterior:
        """The whole graph as it is now, for the covariances of many objects: `.marginals(handle.keys)`.

        Raises:
            SolveError: the graph leaves something undetermined; the message says what is missing.
        """
        return Posterior(self.graph, self.values, [each.keys for each in self.objects])

    def marginals(self, handle: ObjectHandle) -> ObjectCovariance:
        """The object's joint covariance of pose, log-scale and code; raises SolveError where undetermined, and FactorError
        of an object that is not in this graph.

        Linearises what the object is connected with; `posterior` does so once for all.
        """
        return ObjectCovariance.of(self.joint_marginals(handle), "marginals")

    def joint_marginals(self, handle: ObjectHandle, others: Sequence[int] = ()) -> Float[np.ndarray, "d d"]:
        """Joint covariance of the object's pose, log-scale and code and then of `others`, in their order.

        `others` are keys of any variables of the graph, such as cameras: the cross blocks are those of the GTSAM
        tangents, [rotation, translation] in the body frame of a `Pose3`. Raises SolveError where undetermined.
        """
        self._check_known(handle)
        keys = [*handle.keys, *checks.keys(f"{handle.name}: others", others)]
        # of the parts that hold them alone: what another part lacks is nothing to them
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for part in self.problems():
            if any(part.values.exists(key) for key in keys):
                graph.push_back(part.graph)
                values.insert(part.values)
        lonely = {key for key in keys if self.values.exists(key) and not values.exists(key)}
        values.insert(self.values.extract(gtsam.KeyVector([*lonely])))  # named by the posterior
        return Posterior(graph, values, [each.keys for each in self.objects]).joint_covariance(keys)

    def _placed(
        self,
        name: str,
        prior: ShapePrior,
        views: Sequence[ObjectView],
        box: DetectedBox | None,
    ) -> tuple[ObjectState, HeadingModes | None]:
        try:
            return place(prior, views, self.builder, self.initialisation, box)
        except ObjectGraphError as error:
            raise type(error)(f"{name}: {error}") from error

    def _push(self, handle: ObjectHandle, factor: gtsam.NonlinearFactor) -> None:
        handle.slots[self.graph.size()] = factor
        self.graph.push_back(factor)

    def _check_known(self, handle: ObjectHandle) -> None:
        checks.instance("handle", handle, ObjectHandle)
        if not any(each is handle for each in self.objects):
            raise FactorError(f"{handle.name} is not in this graph")

    def _take_out(self, slots: Iterable[int]) -> None:
        for slot in slots:
            self.graph.remove(slot)
        size = self.graph.size()
        while size and not self.graph.exists(size - 1):
            size -= 1
        self.graph.resize(size)

    def _keys_at(self, slot: int) -> list[int] | None:
        return list(self.graph.at(slot).keys()) if self.graph.exists(slot) else None

    def _check_there(self, handle: ObjectHandle, slots: Collection[int]) -> None:
        if max(slots, default=-1) >= self.graph.size():
            raise FactorError(f"{handle.name}: the graph was shortened, its factors are not in it any more")
        for slot in slots:
            if not self.graph.exists(slot) or self.graph.at(slot) is not handle.slots[slot]:
                raise FactorError(
                    f"{handle.name}: the graph was rearranged, its factor {slot} is another one now"
                )

    def _check_removable(self, handle: ObjectHandle) -> None:
        self._check_known(handle)
        self._check_there(handle, handle.slots)
        for slot in range(self.graph.size()):
            found = self._keys_at(slot)
            if slot not in handle.slots and found is not None and set(handle.keys).intersection(found):
                names = ", ".join(readable_key(key) for key in found)
                raise FactorError(f"{handle.name} cannot be removed: your factor {slot} on {names} holds it")

    def _free_number(self) -> int:
        """One that no object's name ends with: where one was removed there are fewer objects than numbers."""
        taken = {each.name.rpartition(" ")[2] for each in self.objects}
        return next(n for n in itertools.count(len(self.objects)) if str(n) not in taken)

    def _free_index(self) -> int:
        index, asked = len(self.objects), set(self.graph.keyVector())  # values may be yet to come
        while any(self.values.exists(key) or key in asked for key in ObjectKeys.numbered(index)):
            index += 1
        return index


def _several(name: str, views: ObjectView | Sequence[ObjectView]) -> list[ObjectView]:
    if isinstance(views, ObjectView):
        return [views]
    what = f"{name}: start (an ObjectState, or views)"
    return list(checks.tuple_of(what, views, ObjectView, ObservationError))


def _parts(groups: Sequence[Sequence[int]]) -> dict[int, int]:
    """Of every key the number of its part: keys of one group are connected."""
    keys = sorted({key for group in groups for key in group})
    column = {key: i for i, key in enumerate(keys)}
    pairs = [(column[group[0]], column[key]) for group in groups for key in group]
    rows, columns = np.array(pairs, dtype=int).reshape(-1, 2).T
    links = coo_matrix((np.ones(len(pairs)), (rows, columns)), shape=(len(keys),) * 2)
    return dict(zip(keys, connected_components(links, directed=False)[1].tolist(), strict=True))
