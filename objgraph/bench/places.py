"""Where the cameras of the study of next views stand."""

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from objgraph.active.cameras import looking_at

HEIGHT_M = (1.2, 1.6)
"""Of the cameras above the floor."""


def half_ring(
    middle_world: Float[np.ndarray, "3"],
    first_world: Float[np.ndarray, "3"],
    floor: float,
    distance: float,
    count: int,
    rng: Generator,
) -> list[gtsam.Pose3]:
    """T_world_camera of cameras that look at the middle from half of the bearings about it, the first camera's among them.

    They stand at a distance along the floor, whose height is given; z is up; metres.
    """
    away = first_world - middle_world
    bearing = np.arctan2(away[1], away[0]) + rng.uniform(-np.pi / 2, np.pi / 2)
    cameras = []
    for turn in rng.uniform(-np.pi / 2, np.pi / 2, count) + bearing:
        eye = middle_world + distance * np.array([np.cos(turn), np.sin(turn), 0.0])
        eye[2] = floor + rng.uniform(*HEIGHT_M)
        cameras.append(looking_at(eye, middle_world, np.array([0.0, 0.0, 1.0])))
    return cameras


def spread_out(apart: Float[np.ndarray, "n n"], count: int) -> list[int]:
    """So many of n places, the first of them among these, whose least distance no exchange of one makes larger."""
    chosen = [0]
    while len(chosen) < count:
        chosen.append(int(apart[chosen].min(axis=0).argmax()))
    moved = True
    while moved:
        moved = False
        for k in range(1, count):
            others = chosen[:k] + chosen[k + 1 :]
            nearest = apart[others].min(axis=0)
            rest = apart[np.ix_(others, others)][~np.eye(count - 1, dtype=bool)].min(initial=np.inf)
            best = int(nearest.argmax())
            if min(nearest[best], rest) > min(nearest[chosen[k]], rest) + 1e-9:
                chosen[k], moved = best, True
    return chosen
