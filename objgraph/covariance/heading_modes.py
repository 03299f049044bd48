"""Quarter turns under which an object fits its box as before: other modes of its posterior, and what they add to its box's."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import ObjectState
from objgraph.errors import CovarianceError

QUARTERS = 4


@dataclass(frozen=True)
class HeadingModes:
    """How likely it is that an object stands as estimated or turned about its up axis, within the same metric box."""

    probability: Float[np.ndarray, "4"]
    """Of turns by 0, 90, 180 and 270 degrees.

    Raises:
        CovarianceError: these are no probabilities, or states are kept of other than four turns.
    """
    states: tuple[ObjectState | None, ...] = ()
    """The object at each of them, of the shape that was likeliest there; empty where they were not kept."""

    def __post_init__(self) -> None:
        p = checks.reals(
            "the probabilities of quarter turns", self.probability, (None,), error=CovarianceError
        )
        if p.shape != (QUARTERS,) or not (p >= 0).all() or abs(p.sum() - 1) > 1e-6:
            raise CovarianceError(f"the probabilities of four quarter turns were expected, got {p}")
        if len(self.states) not in (0, QUARTERS):
            raise CovarianceError(
                f"the states of four quarter turns were expected, or none, got {len(self.states)}"
            )
        object.__setattr__(self, "probability", p)

    @staticmethod
    def of_costs(
        costs: Float[np.ndarray, "4"], temperature: float, states: tuple[ObjectState | None, ...] = ()
    ) -> "HeadingModes":
        """From costs (weighted scores), the estimate's own first; one that is not finite has no chance.

        `temperature` is the cost that counts as one nat; it has to be fitted, for costs are no log-posteriors.
        """
        costs = np.where(np.isfinite(costs), costs, np.inf)
        weight = np.exp((costs.min() - costs) / temperature)
        return HeadingModes(weight / weight.sum(), states)

    @staticmethod
    def of_states(
        states: Sequence[ObjectState], costs: Float[np.ndarray, "s"], estimate: int, temperature: float
    ) -> "HeadingModes":
        """From upright states at about quarter turns of one of them, the estimate; of several at one turn the cheapest."""
        of_turn = np.full(QUARTERS, np.inf)
        cheapest: list[ObjectState | None] = [None] * QUARTERS
        R = states[estimate].T_world_object.rotation()
        for state, cost in zip(states, costs, strict=True):
            between = R.between(state.T_world_object.rotation()).matrix()
            quarter = round(float(np.arctan2(between[0, 2], between[0, 0])) / (np.pi / 2)) % QUARTERS
            if cost < of_turn[quarter]:
                of_turn[quarter], cheapest[quarter] = cost, state
        return HeadingModes.of_costs(of_turn, temperature, tuple(cheapest))

    def turned(self, quarter: int) -> "HeadingModes":
        """The same modes, of the object as it stands at one of them."""
        states = self.states[quarter:] + self.states[:quarter]
        return HeadingModes(np.roll(self.probability, -quarter), states)

    def carried(self, state: ObjectState) -> "HeadingModes":
        """The same modes of the object where it is by now: the other ones go along with it as one body."""
        own = self.states[0] if self.states else None
        if own is None:
            return self
        motion = state.T_world_object.compose(own.T_world_object.inverse())
        states = [
            each and replace(each, T_world_object=motion.compose(each.T_world_object)) for each in self.states
        ]
        return replace(self, states=tuple(states))

    def second_moment(self, extents: Float[np.ndarray, "3"]) -> Float[np.ndarray, "9 9"]:
        """Mean square of what leads from the estimated box to the turned ones, over `BOX_AXES`."""
        swap = np.log(extents[2] / extents[0])
        moment = np.zeros((9, 9))
        for quarter, probability in enumerate(self.probability):
            step = np.zeros(9)
            step[1] = quarter * np.pi / 2 if quarter < 3 else -np.pi / 2
            if quarter % 2:
                step[[6, 8]] = swap, -swap
            moment += probability * np.outer(step, step)
        return moment
