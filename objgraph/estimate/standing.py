"""What is known of up and of the floor, for an estimator that follows gradients: the graph's own factors."""

import gtsam
import numpy as np
from jaxtyping import Float

from factors.base import Annealing
from factors.priors import upright_prior
from factors.state import RIGID_DOF, ObjectState
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.single_object import ALONE


class Standing:
    """The upright prior and, where the floor is known, the floor factor of one object, as `GraphConfig` weighs them."""

    def __init__(self, task: EstimationTask, slope: float) -> None:
        """`slope` is the occupancy's, 1/metres."""
        graph = GraphConfig()
        self._annealing = Annealing(slope)
        self._floor = ObjectBuilder(graph, task.up_world, task.floor).standing(task.prior, ALONE)
        self.factors: list[gtsam.NonlinearFactor] = [factor.gtsam_factor() for factor in self._floor]
        if task.up_world is not None:
            self.factors.append(upright_prior(ALONE, task.up_world, graph.upright_sigma))

    def refresh(self, state: ObjectState) -> None:
        """Choose the floor's rays and their samples where the object is."""
        values = _values(state)
        for factor in self._floor:
            factor.refresh(values, self._annealing)

    def linearize(self, state: ObjectState) -> tuple[Float[np.ndarray, "m d"], Float[np.ndarray, "m"]]:
        """A and b with which half the square of A delta - b is the factors' error about the state, all its axes."""
        values = _values(state)
        A, b = [np.zeros((0, len(state.code) + RIGID_DOF))], [np.zeros(0)]
        for factor in self.factors:
            rows, right = factor.linearize(values).jacobian()
            # the keys of each begin with the pose and go on in the state's order
            A.append(np.pad(rows, ((0, 0), (0, A[0].shape[1] - rows.shape[1]))))
            b.append(right)
        return np.concatenate(A), np.concatenate(b)


def _values(state: ObjectState) -> gtsam.Values:
    values = gtsam.Values()
    state.insert(values, ALONE)
    return values
