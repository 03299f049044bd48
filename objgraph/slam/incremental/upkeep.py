"""What keeps the map's objects where their views say that they are, as the map moves and views are added."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import gtsam
import numpy as np

from factors.linearized import carried_along
from factors.state import ObjectKeys, ObjectState
from objgraph.errors import SolveError
from objgraph.graph.solve import FAILURES
from objgraph.slam.incremental.alone import Alone, is_turned
from objgraph.slam.incremental.config import Tolerance
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import Observation, TrackedObject, cameras_of, entered, linearize

_RESOLVED = 6
"""Views at most with which an object is solved again."""


class Upkeep:
    """Linearises stale observations anew, and solves objects again that were settled by fewer views."""

    def __init__(self, system: IncrementalSystem) -> None:
        self._system = system

    def renew(self, entries: Sequence[TrackedObject], tolerance: Tolerance, limit: int | None = None) -> int:
        """Linearise anew the observations that are farthest from where they were linearised; how many they were.

        Those that only went along with a loop that was closed are carried along, without decoding. Raises what a decoder or the
        smoother does, and has then linearised none anew.
        """
        stale: list[tuple[float, TrackedObject, Observation]] = []
        travelled: list[tuple[Observation, gtsam.Values]] = []
        for entry in entries:
            self._system.prune(entry)
            values = self._system.estimates([entry], cameras_of(entry.observations))
            for observation in entry.observations:
                departure = entry.departure(observation, values, tolerance)
                if departure > 1:
                    stale.append((departure, entry, observation))
                elif entry.has_travelled(observation, values):
                    travelled.append((observation, values))
        self._carry_along(travelled)
        stale = sorted(stale, key=lambda each: -each[0])[:limit]
        if not stale:
            return 0
        observations = [observation for *_, observation in stale]
        owners = {entry.name: entry for _, entry, _ in stale}
        values = self._system.estimates(list(owners.values()), cameras_of(observations))
        self._linearize_anew(observations, values)
        return len(stale)

    def resolve(self, entry: TrackedObject, other_keys: Callable[[], ObjectKeys]) -> bool:
        """Solve the object alone, nonlinearly, against cameras as they are, and linearise all its observations there;
        whether it has turned.

        Mends what was settled by few views, a wrong heading too: one that turns goes on under `other_keys`, for no
        linear step leads there. It costs some linearisations of every view, so it is for now and then. With a lag, an
        object whose first views are past it keeps its heading: what they said cannot be taken back. Raises
        ObjectGraphError, and has then changed nothing.
        """
        entry.views_solved = entry.views  # one that fails would otherwise be tried at every frame
        self._system.prune(entry)
        placed, state = entry.placed_views, self._system.state(entry)
        some = np.unique(np.linspace(0, len(placed) - 1, min(len(placed), _RESOLVED)).astype(int))
        views = [placed[i][1].at(self._system.camera_pose(placed[i][0])) for i in some]
        alone = Alone(entry.name, entry.prior, views, self._system.builder, self._system.config)
        may_turn = not self._system.keeps_lost_views(entry)
        found = alone.again_in_all_headings(state) if may_turn else alone.again(state)
        turns = is_turned(found.state, state)
        if turns and not may_turn:
            raise SolveError(f"{entry.name}: it would turn, against what views past the lag have said")
        if turns:
            self._turn(entry, other_keys(), found.state)
        else:
            values = self._system.estimates([], cameras_of(entry.observations))
            found.state.insert(values, entry.keys)
            self._linearize_anew(entry.observations, values)
        if may_turn:
            entry.other_headings = found.turns
        return turns

    def _linearize_anew(self, observations: Sequence[Observation], values: gtsam.Values) -> None:
        before = [(observation.quadratic, observation.point) for observation in observations]
        try:
            quadratics = linearize(observations, values, self._system.slope)
            self._system.replace(observations, quadratics, values)
        except FAILURES:
            self._system.take_back(observations, before)
            raise

    def _turn(self, entry: TrackedObject, keys: ObjectKeys, state: ObjectState) -> None:
        """The object anew, under other keys; raises SolveError, and has then changed nothing."""
        self._system.check_free(entry)
        anew = replace(entry, keys=keys)
        priors, observations, quadratics, at = self._system.settled_at(anew, state, entry.placed_views)
        values = at.extract(gtsam.KeyVector([*keys]))
        numbers = self._system.commit([*priors, *quadratics], values, remove=self._system.numbers_of(entry))
        entered(observations, quadratics, numbers[len(priors) :], at)
        entry.keys, entry.numbers, entry.observations = keys, numbers[: len(priors)], observations

    def _carry_along(self, travelled: Sequence[tuple[Observation, gtsam.Values]]) -> None:
        if not travelled:
            return
        moved = []
        for observation, values in travelled:
            pose, camera = observation.keys[0], observation.camera
            assert observation.quadratic is not None
            assert camera is not None
            moved.append(carried_along(observation.quadratic, observation.point, values, pose, camera))
        observations = [observation for observation, _ in travelled]
        numbers = self._system.commit(
            [factor for factor, _ in moved], remove=[o.number for o in observations]
        )
        for observation, number, (quadratic, point) in zip(observations, numbers, moved, strict=True):
            observation.number, observation.quadratic, observation.point = number, quadratic, point
