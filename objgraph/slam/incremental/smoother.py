"""An incremental smoother that is either updated or left as it was: GTSAM's ISAM2, with or without a fixed lag."""

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeVar

import gtsam
import numpy as np
from jaxtyping import Float

from factors.keys import readable_key
from objgraph.covariance import joint as tree
from objgraph.errors import SolveError

_T = TypeVar("_T")


class Smoother:
    """ISAM2 with the newest variable eliminated last; a failed update changes nothing.

    Python exceptions and singular systems leave ISAM2 half updated: after one, it is built anew from the factors
    and the linearisation point that it had.
    """

    def __init__(self, lag: float | None = None, relinearize: float = 0.02, wildfire: float = 1e-4) -> None:
        """`lag`: time after which a variable is marginalised out; None keeps all.

        `relinearize` is the tangent step (radians, metres) at which a variable's factors are linearised again,
        `wildfire` the change below which a step is not carried on.
        """
        self._lag, self._relinearize, self._wildfire = lag, relinearize, wildfire
        self._system = self._empty()
        self._numbers = itertools.count()
        self._slots: dict[int, int] = {}
        """A factor's number, which never changes, to its slot in GTSAM's list, which a restoration does."""
        self._factors: dict[int, gtsam.NonlinearFactor] = {}
        self._times: dict[int, float] = {}

    def update(
        self,
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
        *,
        remove: Sequence[int] = (),
        newest: int | None = None,
        times: Mapping[int, float] | None = None,
    ) -> list[int]:
        """One step: add factors and variables, remove factors, and solve; the new factors' numbers.

        A variable whose last factor is removed goes with it. `newest` is the variable to be eliminated last (the
        camera that the next step will touch). With a lag, `times` has the time of every variable that is new or is
        to live on.

        Raises:
            SolveError: the system cannot be solved, no factor is on a new variable, or a factor could not be evaluated or
                is not there to be removed; nothing has been changed.
        """
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values() if values is None else values
        for factor in factors:
            graph.push_back(factor)
        loose = set(values.keys()) - set(graph.keyVector())
        if loose:
            names = ", ".join(map(readable_key, sorted(loose)))
            raise SolveError(f"{names}: no factor of this update says anything of them")
        gone = [number for number in remove if not self.holds(number)]
        if gone:
            raise SolveError(
                f"factors {gone} cannot be removed: they are not in the incremental system any more"
            )
        slots = [self._slots[number] for number in remove]
        before = None if self._lag is None else self._listed()
        point = gtsam.Values(self._isam.getLinearizationPoint())  # which a failed update has moved on
        try:
            found = self._step(graph, values, slots, newest, times or {})
        except (
            Exception
        ) as error:  # whatever it was: Python's own from a custom factor, GTSAM's from the solution
            self._restore(before, point)
            raise SolveError(f"the incremental update failed and was taken back: {error}") from error
        for number in remove:
            del self._slots[number], self._factors[number]
        numbers = [next(self._numbers) for _ in found]
        self._slots.update(zip(numbers, found, strict=True))
        self._factors.update(zip(numbers, factors, strict=True))
        if self._lag is not None:
            self._times.update(times or {})
            self._forget()
        return numbers

    def settle(self) -> None:
        """Bring every variable to the least cost that the factors have, linearised there; costs as much as the map is large.

        Levenberg-Marquardt on all factors as they are, so that nothing is left of steps that were too small to be
        carried on, or of linearisation points that were near enough.

        Raises:
            SolveError: the system cannot be solved; nothing has been changed.
        """
        graph, slots = self._graph()
        if not graph.size():
            return
        params = gtsam.LevenbergMarquardtParams()
        params.setRelativeErrorTol(1e-10)
        try:
            start = self._isam.calculateBestEstimate().extract(graph.keyVector())
            best = gtsam.LevenbergMarquardtOptimizer(graph, start, params).optimize()
            self._rebuild(graph, slots, best)
        except Exception as error:  # as in `update`
            raise SolveError(f"the incremental map cannot be settled: {error}") from error

    def factors_without(self, numbers: Collection[int]) -> list[gtsam.NonlinearFactor]:
        """All factors but those of these numbers; with a lag, what it has made of variables past it among them."""
        graph, slots = self._graph()
        out = {slots[number] for number in numbers}
        return [graph.at(i) for i in range(graph.size()) if i not in out]

    def has(self, key: int) -> bool:
        return self._isam.valueExists(key)

    def holds(self, number: int) -> bool:
        """Whether a factor is still there; with a lag it is gone once one of its variables is marginalised out."""
        return number in self._slots

    def pose(self, key: int) -> gtsam.Pose3:
        """A variable's estimate; raises SolveError where it is not in the system, or no pose."""
        self._check([key])
        return pose_of(self._isam, key)

    def vector(self, key: int) -> Float[np.ndarray, "d"]:
        self._check([key])
        return np.array(self._isam.calculateEstimateVector(key))

    def estimate(self) -> gtsam.Values:
        """Every variable's estimate; the larger the map, the longer it takes."""
        return self._isam.calculateEstimate()

    def marginal_factors(self, keys: Sequence[int]) -> list[gtsam.LinearContainerFactor]:
        """Factors on `keys` alone that say of them what the whole system does.

        Raises:
            SolveError: a key is not in the system, or the system does not determine it.
        """
        self._check(keys)
        return marginal_factors(self._isam, keys)

    def covariance(self, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
        """Joint marginal covariance of `keys`, in their order; raises SolveError as `marginal_factors` does."""
        self._check(keys)
        return joint_covariance(self._isam, keys)

    @property
    def _isam(self) -> gtsam.ISAM2:
        return self._system if isinstance(self._system, gtsam.ISAM2) else self._system.getISAM2()

    def _empty(self) -> "gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother":
        params = gtsam.ISAM2Params()
        params.relinearizeSkip = 1
        params.setRelinearizeThreshold(self._relinearize)
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(self._wildfire))
        if self._lag is None:
            return gtsam.ISAM2(params)
        params.findUnusedFactorSlots = True
        return gtsam.IncrementalFixedLagSmoother(self._lag, params)

    def _step(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        remove: list[int],
        newest: int | None,
        times: Mapping[int, float],
    ) -> list[int]:
        if isinstance(self._system, gtsam.ISAM2):
            groups = gtsam.KeyGroupMap()
            if newest is not None:
                groups.insert2(newest, 1)
            return list(self._system.update(graph, values, remove, groups).getNewFactorsIndices())
        self._system.update(graph, values, {**times}, remove)
        return list(self._system.getISAM2Result().getNewFactorsIndices())

    def _listed(self) -> list[gtsam.NonlinearFactor | None]:
        """All factors by their slots, those of the marginalised variables' making among them."""
        graph = self._isam.getFactorsUnsafe()  # the list itself: it changes with the next update
        return [graph.at(i) if graph.exists(i) else None for i in range(graph.size())]

    def _graph(
        self, listed: Sequence[gtsam.NonlinearFactor | None] | None = None
    ) -> tuple[gtsam.NonlinearFactorGraph, dict[int, int]]:
        """All factors and the slots of those that have a number; `listed` are those there are, by their slots now."""
        if listed is None and self._lag is None:
            known = [*self._factors.items()]
        else:
            number_of = {slot: number for number, slot in self._slots.items()}
            listed = self._listed() if listed is None else listed
            known = [
                (number_of.get(slot), factor) for slot, factor in enumerate(listed) if factor is not None
            ]
        graph, slots = gtsam.NonlinearFactorGraph(), {}
        for number, factor in known:
            if number is not None:
                slots[number] = graph.size()
            graph.push_back(factor)
        return graph, slots

    def _restore(self, listed: Sequence[gtsam.NonlinearFactor | None] | None, point: gtsam.Values) -> None:
        """Build the system anew as it was, linearised at `point`; `listed` are its factors before, where it has made some of
        its own."""
        graph, slots = self._graph(listed)
        self._rebuild(graph, slots, point.extract(graph.keyVector()))

    def _rebuild(self, graph: gtsam.NonlinearFactorGraph, slots: dict[int, int], point: gtsam.Values) -> None:
        """A system of these factors, linearised at `point`; where that fails, the one before stays."""
        before, self._system = self._system, self._empty()
        try:
            if graph.size():
                self._step(graph, point, [], None, self._times)
        except Exception:  # whatever it was, the caller hears of it with the old system in place
            self._system = before
            raise
        self._slots = slots

    def _forget(self) -> None:
        """Drop the numbers of factors that went with a variable past the lag."""
        alive = {key for key in self._times if self.has(key)}
        self._times = {key: self._times[key] for key in alive}
        gone = [n for n, factor in self._factors.items() if not alive.issuperset(factor.keys())]
        for number in gone:
            del self._slots[number], self._factors[number]

    def _check(self, keys: Sequence[int]) -> None:
        missing = [readable_key(key) for key in keys if not self.has(key)]
        if missing:
            raise SolveError(f"{', '.join(missing)}: not in the incremental system (or past its lag)")


def marginal_factors(isam: gtsam.ISAM2, keys: Sequence[int]) -> list[gtsam.LinearContainerFactor]:
    """Factors on `keys` alone that say of them what the whole system does; raises SolveError where it hardly does."""
    point, joint = isam.getLinearizationPoint(), determined(keys, isam.joint)
    parts = [joint.at(i) for i in range(joint.size())]
    return [
        gtsam.LinearContainerFactor(part, point.extract(gtsam.KeyVector(list(part.keys())))) for part in parts
    ]


def joint_covariance(isam: gtsam.ISAM2, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
    """Joint marginal covariance of `keys`, in their order; raises SolveError where the system hardly determines them."""
    return determined(keys, lambda keys: tree.joint_covariance(isam, keys))


def pose_of(isam: gtsam.ISAM2, key: int) -> gtsam.Pose3:
    """The estimate of a variable that the system has; raises SolveError where it is of something else."""
    try:
        return isam.calculateEstimatePose3(key)
    except RuntimeError as error:
        raise SolveError(f"{readable_key(key)} holds no pose") from error


def determined(keys: Sequence[int], query: Callable[[gtsam.KeyVector], _T]) -> _T:
    """What a query of these variables answers; raises SolveError where the system does not determine them."""
    try:
        return query(gtsam.KeyVector([*keys]))
    # GTSAM's "indeterminate linear system", or a variable without any factor
    except (RuntimeError, IndexError) as error:
        names = ", ".join(readable_key(key) for key in keys)
        raise SolveError(f"{names}: the incremental system hardly determines them: {error}") from error
