"""An incremental smoother that is either updated or left as it was: GTSAM's ISAM2, with or without a fixed lag."""

import itertools
from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
from jaxtyping import Float

from factors.keys import readable_key
from objgraph.errors import SolveError


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
            SolveError: the system cannot be solved, or a factor could not be evaluated; nothing has been changed.
        """
        graph = gtsam.NonlinearFactorGraph()
        for factor in factors:
            graph.push_back(factor)
        slots = [self._slots[number] for number in remove]
        before = None if self._lag is None else self._listed()
        try:
            found = self._step(graph, values or gtsam.Values(), slots, newest, times or {})
        except (
            Exception
        ) as error:  # whatever it was: Python's own from a custom factor, GTSAM's from the solution
            self._restore(before)
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

    def has(self, key: int) -> bool:
        return self._isam.valueExists(key)

    def holds(self, number: int) -> bool:
        """Whether a factor is still there; with a lag it is gone once one of its variables is marginalised out."""
        return number in self._slots

    def pose(self, key: int) -> gtsam.Pose3:
        return self._isam.calculateEstimatePose3(key)

    def vector(self, key: int) -> Float[np.ndarray, "d"]:
        return np.array(self._isam.calculateEstimateVector(key))

    def estimate(self) -> gtsam.Values:
        """Every variable's estimate; the larger the map, the longer it takes."""
        return self._isam.calculateEstimate()

    def marginal_factors(self, keys: Sequence[int]) -> list[gtsam.LinearContainerFactor]:
        """Factors on `keys` alone that say of them what the whole system does; raises SolveError for an unknown key."""
        self._check(keys)
        point = self._isam.getLinearizationPoint()
        joint = self._isam.joint(gtsam.KeyVector(list(keys)))
        parts = [joint.at(i) for i in range(joint.size())]
        return [
            gtsam.LinearContainerFactor(part, point.extract(gtsam.KeyVector(list(part.keys()))))
            for part in parts
        ]

    def covariance(self, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
        """Joint marginal covariance of `keys`, in their order; raises SolveError for an unknown key."""
        self._check(keys)
        return np.array(self._isam.jointMarginalCovariance(gtsam.KeyVector(list(keys))).fullMatrix())

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

    def _restore(self, listed: Sequence[gtsam.NonlinearFactor | None] | None) -> None:
        """Build the system anew; `listed` are its factors before, where it has made some of its own."""
        point = self._isam.getLinearizationPoint()
        graph, slots = gtsam.NonlinearFactorGraph(), {}
        if listed is None:
            known = list(self._factors.items())
        else:
            number_of = {slot: number for number, slot in self._slots.items()}
            known = [
                (number_of.get(slot), factor) for slot, factor in enumerate(listed) if factor is not None
            ]
        for number, factor in known:
            if number is not None:
                slots[number] = graph.size()
            graph.push_back(factor)
        values = point.extract(graph.keyVector())
        self._system = self._empty()
        if graph.size():
            self._step(graph, values, [], None, self._times)
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
