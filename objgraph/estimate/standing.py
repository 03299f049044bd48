"""What the graph knows of floor and gravity, as a term of a loss that is descended: the graph's own factors."""

import gtsam
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors.state import POSE_DOF, RIGID_DOF, ObjectState
from objgraph.estimate.task import EstimationTask
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.single_object import ALONE

_COLUMNS = {
    ALONE.pose: slice(0, POSE_DOF),
    ALONE.log_scale: slice(POSE_DOF, RIGID_DOF),
    ALONE.code: slice(RIGID_DOF, None),
}


class Standing:
    """The upright prior and the floor's factor of one object, with the weights that the graph gives them."""

    def __init__(self, task: EstimationTask) -> None:
        builder = ObjectBuilder(up_world=task.up_world, floor=task.floor)
        self._floor = builder.standing(task.prior, ALONE)
        self._factors = [builder.upright(ALONE), *(factor.gtsam_factor() for factor in self._floor)]

    def refresh(self, state: ObjectState) -> None:
        """Freeze the floor's rays where the object is."""
        for factor in self._floor:
            factor.refresh(_values(state))

    def loss(self, state: ObjectState, delta: Float[Tensor, "d"]) -> Float[Tensor, ""]:
        """Half the squared residuals, linear in how far the state moves; gradient at zero as that of the factors."""
        values, loss = _values(state), delta.new_zeros(())
        for factor in self._factors:
            linear = gtsam.JacobianFactor(factor.linearize(values))
            A, column = np.zeros((linear.rows(), len(delta))), 0
            blocks = linear.getA()
            for key in list(linear.keys()):
                to = A[:, _COLUMNS[key]]
                to[:] = blocks[:, column : column + to.shape[1]]
                column += to.shape[1]
            residual = torch.as_tensor(A).to(delta) @ delta - torch.as_tensor(linear.getb()).to(delta)
            loss = loss + 0.5 * residual.square().sum()
        return loss


def _values(state: ObjectState) -> gtsam.Values:
    values = gtsam.Values()
    state.insert(values, ALONE)
    return values
