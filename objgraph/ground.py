"""The floor as an observation: nothing of an object lies below it."""

import gtsam
import numpy as np
from jaxtyping import Float

from factors.rays import Rays
from objgraph.initial_box import upright_axes

_BELOW = 3.0
"""Depth of the imagined camera under the floor, metres."""


def rays_from_below(
    points_world: Float[np.ndarray, "n 3"],
    up_world: Float[np.ndarray, "3"],
    floor: float,
    spacing: float = 0.08,
    reach: float = 0.5,
    sigma: float = 0.01,
) -> tuple[gtsam.Pose3, Rays]:
    """An imagined camera under the floor that looks up and sees nothing before the floor: pose and rays.

    Rays are `spacing` metres apart over the points' level extent widened by `reach`: dense enough that no leg goes
    on unseen under the floor, where a shape could grow at no cost. `floor` is its height along `up_world`, `sigma`
    how well that is known.
    """
    axes = upright_axes(up_world, 0.0)
    R_world_camera = np.stack([axes[:, 0], -axes[:, 2], axes[:, 1]], axis=1)
    level = points_world @ R_world_camera[:, :2]
    low, high = np.percentile(level, [1, 99], axis=0) + [[-reach], [reach]]
    x, y = (np.arange(a, b, spacing) for a, b in zip(low, high, strict=True))
    middle = 0.5 * (low + high)
    across = np.stack(np.meshgrid(x - middle[0], y - middle[1]), axis=-1).reshape(-1, 2)
    directions = np.column_stack([across / _BELOW, np.ones(len(across))])
    eye = R_world_camera @ [*middle, floor - _BELOW]
    depth = np.full(len(across), _BELOW)
    rays = Rays(directions, depth, np.zeros(len(across), dtype=bool), depth, np.full(len(across), sigma))
    return gtsam.Pose3(gtsam.Rot3(R_world_camera), eye), rays
