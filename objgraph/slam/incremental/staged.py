"""A smoother that is the caller's: read from, never written to."""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from jaxtyping import Float

from factors.keys import readable_key
from objgraph.covariance.posterior import Posterior
from objgraph.errors import SolveError
from objgraph.slam.incremental.smoother import determined


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
        """Note what is to be added and removed; the new factors' numbers. Raises SolveError for what is not there."""
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

    def check_accepted(self) -> None:
        """Raises SolveError where the caller has not told the slots of the last step's factors."""
        if self._handed:
            raise SolveError(
                "the last step's factors have no slots yet: update your smoother, then call "
                "`accept(smoother.update(...).getNewFactorsIndices())`"
            )

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
        return values.atPose3(key) if values.exists(key) else self._isam.calculateEstimatePose3(key)

    def vector(self, key: int) -> Float[np.ndarray, "d"]:
        self._check([key])
        values = self._values
        return np.array(
            values.atVector(key) if values.exists(key) else self._isam.calculateEstimateVector(key)
        )

    def marginal_factors(self, keys: Sequence[int]) -> list[gtsam.LinearContainerFactor]:
        """Factors on `keys` alone that say of them what the whole system does; raises SolveError as `Smoother` does."""
        self._check(keys)
        if not any(self._values.exists(key) for key in keys):
            return self._owner_s_marginals(keys)
        point = gtsam.Values()
        for key in keys:
            self._copy(key, point)
        root = np.linalg.inv(np.linalg.cholesky(self.covariance(keys)))
        unit = gtsam.noiseModel.Unit.Create(len(root))
        blocks = np.split(root, np.cumsum([_dim(point, key) for key in keys])[:-1], axis=1)
        terms = [(key, np.asfortranarray(block)) for key, block in zip(keys, blocks, strict=True)]
        return [gtsam.LinearContainerFactor(gtsam.JacobianFactor(terms, np.zeros(len(root)), unit), point)]

    def covariance(self, keys: Sequence[int]) -> Float[np.ndarray, "d d"]:
        """Joint marginal covariance of `keys`, in their order; raises SolveError as `Smoother` does."""
        self._check(keys)
        if not any(self._values.exists(key) for key in keys):
            return np.array(determined(keys, self._isam.jointMarginalCovariance).fullMatrix())
        graph, values = self._about(keys)
        return Posterior(graph, values).joint_covariance(keys)

    @property
    def _isam(self) -> gtsam.ISAM2:
        return self._owner if isinstance(self._owner, gtsam.ISAM2) else self._owner.getISAM2()

    def _about(self, keys: Sequence[int]) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """What is new about `keys`, and what the caller's smoother says of the variables that it hangs on."""
        reached, graph = set(keys), gtsam.NonlinearFactorGraph()
        left = [*self._new.values()]
        while found := [f for f in left if any(map(self._values.exists, reached.intersection(f.keys())))]:
            left = [factor for factor in left if factor not in found]
            for factor in found:
                graph.push_back(factor)
                reached.update(factor.keys())
        values = gtsam.Values()
        for key in reached:
            self._copy(key, values)
        for factor in self._owner_s_marginals([key for key in reached if not self._values.exists(key)]):
            graph.push_back(factor)
        return graph, values

    def _owner_s_marginals(self, keys: Sequence[int]) -> list[gtsam.LinearContainerFactor]:
        point, joint = self._isam.getLinearizationPoint(), determined(keys, self._isam.joint)
        parts = [joint.at(i) for i in range(joint.size())]
        return [
            gtsam.LinearContainerFactor(part, point.extract(gtsam.KeyVector(list(part.keys()))))
            for part in parts
        ]

    def _copy(self, key: int, into: gtsam.Values) -> None:
        own = gtsam.KeyVector([key])
        into.insert(self._values.extract(own) if self._values.exists(key) else self._estimate().extract(own))

    def _estimate(self) -> gtsam.Values:
        return self._isam.calculateEstimate()

    def _check(self, keys: Sequence[int]) -> None:
        missing = [readable_key(key) for key in keys if not self.has(key)]
        if missing:
            raise SolveError(f"{', '.join(missing)}: not in your smoother (or past its lag)")


def _dim(values: gtsam.Values, key: int) -> int:
    return values.extract(gtsam.KeyVector([key])).dim()
