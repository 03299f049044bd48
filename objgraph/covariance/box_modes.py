"""Where an object's box may be, one Gaussian for each heading that it may have; and what of them holds a box, at a level."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float

from factors.state import ObjectState
from objgraph.covariance.box import BoxPose
from objgraph.covariance.heading_modes import QUARTERS, HeadingModes

EVERY_AXIS = tuple(range(9))
HEADING_AXIS = (1,)
"""Of `BOX_AXES`: the rotation about the object's up axis."""


@dataclass(frozen=True)
class BoxMode:
    """The box at one of the headings."""

    probability: float
    box: BoxPose
    axes: Float[np.ndarray, "9 9"]
    """Orthogonal: what takes a tangent of the estimate's box into this one's axes."""


def box_modes(box: BoxPose, state: ObjectState, turns: HeadingModes | None) -> tuple[BoxMode, ...]:
    """The boxes of all headings that have a chance, the estimate's own first.

    `box` is that of `state` with the covariance of its own heading alone (`box_pose` without `turns`). Every other one has the
    same covariance, turned into its own axes.
    """
    if turns is None:
        return (BoxMode(1.0, box, np.eye(9)),)
    T_object_box = state.T_world_object.inverse().compose(box.T_world_box)
    modes = []
    for quarter, probability in enumerate(turns.probability):
        if quarter == 0 or probability > 0:
            turned = turns.states[quarter] if turns.states else None
            there = _at(box, state, turned, T_object_box, quarter)
            modes.append(BoxMode(float(probability), there, turned_axes(quarter)))
    return tuple(modes)


def _at(
    box: BoxPose, state: ObjectState, turned: ObjectState | None, T_object_box: gtsam.Pose3, quarter: int
) -> BoxPose:
    if quarter == 0:
        return box
    axes = turned_axes(quarter)
    covariance = replace(box.covariance, matrix=axes @ box.covariance.matrix @ axes.T)
    if turned is None:
        T_world_box = box.T_world_box.compose(gtsam.Pose3(gtsam.Rot3.Ry(quarter * np.pi / 2), np.zeros(3)))
        return BoxPose(T_world_box, np.abs(axes[6:, 6:] @ box.extents), covariance)
    extents = box.extents * np.exp(turned.log_scale - state.log_scale)
    return BoxPose(turned.T_world_object.compose(T_object_box), extents, covariance)


def turned_axes(quarter: int) -> Float[np.ndarray, "9 9"]:
    """What takes a tangent over `BOX_AXES` into the axes of the same box turned by so many quarters about its y axis."""
    R = np.round(gtsam.Rot3.Ry(quarter % QUARTERS * np.pi / 2).matrix()).T
    axes = np.zeros((9, 9))
    axes[:3, :3] = axes[3:6, 3:6] = R
    axes[6:, 6:] = np.abs(R)
    return axes


def factor_needed(
    modes: Sequence[tuple[float, Float[np.ndarray, "9"]]],
    covariance: Float[np.ndarray, "9 9"],
    radius: float,
    axes: Sequence[int] = EVERY_AXIS,
) -> float:
    """Least factor on all covariances at which the set of a mixture holds a box.

    The set is where d^2 - 2 log(p / p_likeliest) is at most `radius` for one of the modes, d the Mahalanobis distance from it and p
    its probability: of one Gaussian its ellipsoid. A mode whose probability alone takes it beyond has no part in it.

    Args:
        modes: of each its probability, and the error from it to the box in the axes of the estimate's (`BoxMode.axes`).
        covariance: of the estimate's, over `BOX_AXES`.
        radius: the chi-squared quantile of the level, with as many degrees of freedom as there are axes.
        axes: which of `BOX_AXES` are asked for.
    """
    information = np.linalg.inv(np.asarray(covariance)[np.ix_(axes, axes)])
    needed, likeliest = np.inf, max(probability for probability, _ in modes)
    for probability, error in modes:
        left = radius + 2 * np.log(max(probability / likeliest, 1e-300))
        if left > 0:
            some = np.asarray(error)[list(axes)]
            needed = min(needed, float(some @ information @ some) / left)
    return needed
