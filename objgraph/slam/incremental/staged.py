"""A smoother that is the caller's: read from, never written to."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from jaxtyping import Float

from factors.keys import readable_key
from objgraph.errors import SolveError
from objgraph.slam.incremental.smoother import determined, joint_covariance, marginal_factors, pose_of


class Changes(NamedTuple):
    """What an `ISAM2.update` is to be given."""

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    remove: list[int]


class StagedSmoother:
    """Answers as the caller's smoother does, with what is to be added to it on top; collects what that is."""

    def __init__(self, owner: gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother) -> None:
        self._owner = owner
        self._numbers = itertools.count()
        self._slots: dict[int, tuple[int, list[int]]] = {}
        """Of the factors that the caller has added: their slots and their keys."""
        self._new: dict[int, gtsam.NonlinearFactor] = {}
        self._values = gtsam.Values()
        self._remove: list[int] = []
        self._handed: list[int] = []
        """Numbers of the factors whose slots the caller has not told yet."""

    def update(
        self,
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
        *,
        remove: Sequence[int] = (),
        newest: int | None = None,
        times: Mapping[int, float] | None = None,
    ) -> list[int]:
        """Note what is to be added and removed; the new factors' numbers.

        Raises:
            SolveError: a factor to be removed is not there, or a new variable's key is taken; nothing has been changed.
        """
        taken = [] if values is None else list(filter(self.has, values.keys()))
        if taken:
            raise SolveError(
                f"{', '.join(map(readable_key, taken))}: in your smoother already: give other object_keys"
            )
        gone = [number for number in remove if not self.holds(number)]
        if gone:
            raise SolveError(f"factors {gone} cannot be removed: they are not in your smoother any more")
        for number in remove:
            if self._new.pop(number, None) is None:
                self._remove.append(self._slots.pop(number)[0])
        numbers = [next(self._numbers) for _ in factors]
        self._new.update(zip(numbers, factors, strict=True))
        if values is not None:
            self._values.insert(values)
        used = set[int]().union(*(factor.keys() for factor in self._new.values()))
        for key in set(self._values.keys()) - used:  # as in ISAM2 a variable goes with its last factor
            self._values.erase(key)
        return numbers

    def hand_over(self) -> Changes:
        """What has been collected; from then on it counts as the caller's."""
        graph = gtsam.NonlinearFactorGraph()
        for factor in self._new.values():
            graph.push_back(factor)
        changes = Changes(graph, self._values, self._remove)
        self._handed = [*self._new]
        self._slots |= {number: (-1, list(factor.keys())) for number, factor in self._new.items()}
        self._new, self._values, self._remove = {}, gtsam.Values(), []
        return changes

    def accept(self, slots: Sequence[int]) -> None:
        """Where the caller's smoother has put the factors that were handed over, in their order.

        Raises:
            SolveError: there are not as many.
        """
        if len(slots) != len(self._handed):
            raise SolveError(
                f"{len(slots)} slots for {len(self._handed)} factors: give those of the step's factors alone, in order"
            )
        for number, slot in zip(self._handed, slots, strict=True):
            self._slots[number] = (int(slot), self._slots[number][1])
        self._handed = []
        if not isinstance(self._owner, gtsam.ISAM2):  # a fixed lag has taken some out
            self._slots = {number: slot for number, slot in self._slots.items() if self.holds(number)}

    def check_accepted(self) -> None:
        """Raises SolveError where the caller has not told the slots of the last step's factors."""
        if self._handed:
            raise SolveError(
                "the last step's factors have no slots yet: update your smoother, then call "
                "`accept(smoother.update(...).getNewFactorsIndices())`"
            )

    def factors_without(self, numbers: Collection[int]) -> list[gtsam.NonlinearFactor]:
        """All factors but those of these numbers, and but those that are to be removed; a fixed lag's own among them."""
        graph = self._isam.getFactorsUnsafe()
        out = {*self._remove, *(self._slots[number][0] for number in numbers if number in self._slots)}
        held = [graph.at(i) for i in range(graph.size()) if i not in out and graph.exists(i)]
        return [*held, *(factor for number, factor in self._new.items() if number not in numbers)]

    def has(self, key: int) -> bool:
        return self._values.exists(key) or self._isam.valueExists(key)

    def holds(self, number: int) -> bool:
        """Whether a factor is there: a fixed lag takes factors out, and may use their slots again."""
        if number in self._new:
            return True
        slot, keys = self._slots.get(number, (-1, []))
        graph = self._isam.getFactorsUnsafe()
        return 0 <= slot < graph.size() and graph.exists(slot) and list(graph.at(slot).keys()) == keys

    def pose(self, key: int) -> gtsam.Pose3:
        self._check([key])
        values = self._values
        return values.atPose3(key) if values.exists(key) else pose_of(self._isam, key)

    def vector(self, key: int) -> Float[np.ndarray, "d"]:
        self._check([key])
        values = self._values
        return np.array(
            values.atVector(key) if values.exists(key) else self._isam.calculateEstimateVector(key)
        )

    def marginal_factors(self, keys: Sequence[int]) -> list[gtsam.LinearContainerFactor]:
        """Factors on `keys` alone that say of them what the whole system does; raises SolveError as `Smoother` does."""
        return marginal_factors(self._about(keys), keys)

    def covariance(self, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
        """Joint marginal covariance of `keys`, in their order; raises SolveError as `Smoother` does."""
        return joint_covariance(self._about(keys), keys)

    @property
    def _isam(self) -> gtsam.ISAM2:
        return self._owner if isinstance(self._owner, gtsam.ISAM2) else self._owner.getISAM2()

    def _about(self, keys: Sequence[int]) -> gtsam.ISAM2:
        """The caller's system or, where one of `keys` is new, what is new about them on top of what that says."""
        self._check(keys)
        if not any(self._values.exists(key) for key in keys):
            return self._isam
        reached, graph = set(keys), gtsam.NonlinearFactorGraph()
        left = [*self._new.values()]
        while found := [f for f in left if any(map(self._values.exists, reached.intersection(f.keys())))]:
            left = [factor for factor in left if factor not in found]
            for factor in found:
                graph.push_back(factor)
                reached.update(factor.keys())
        values, estimate = gtsam.Values(), self._isam.calculateEstimate()
        for key in reached:
            holder = self._values if self._values.exists(key) else estimate
            values.insert(holder.extract(gtsam.KeyVector([key])))
        for factor in marginal_factors(self._isam, [k for k in reached if not self._values.exists(k)]):
            graph.push_back(factor)
        local = gtsam.ISAM2()
        determined(keys, lambda _: local.update(graph, values))
        return local

    def _check(self, keys: Sequence[int]) -> None:
        missing = [readable_key(key) for key in keys if not self.has(key)]
        if missing:
            raise SolveError(f"{', '.join(missing)}: not in your smoother (or past its lag)")
