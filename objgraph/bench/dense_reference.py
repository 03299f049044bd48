"""Camera poses from whole depth images alone: a reference where a data set's own poses are another reconstruction's.

How far the registrations disagree with the poses that they give together says how much these can tell.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objgraph.errors import EvaluationError
from objgraph.geometry.frames import transformed
from objgraph.observation.frames import Frame
from objgraph.sensor.registration import Pair, cloud_of, parts, registered, together

AHEAD = 2.0
"""Metres before a camera at which two of its poses are compared: an error of rotation counts by what it moves there."""


@dataclass(frozen=True)
class DenseReference:
    """Poses by registration of depth images with each other; the first is as it was given."""

    T_world_camera: Float[np.ndarray, "n 4 4"]
    pairs: int
    """Frames registered with each other."""
    spread_m: float
    """Median distance by which a registration and the poses disagree about what is 2 m ahead."""
    given_spread_m: float
    """The same of the poses that were given."""


def dense_reference(
    frames: Sequence[Frame], progress: Callable[[int, int], None] | None = None
) -> DenseReference:
    """Register all frames that overlap, beginning at their own poses.

    Raises:
        EvaluationError: frames that overlap do not connect all with the first, so the poses of some are unknown.
    """
    clouds = [cloud_of(frame) for frame in frames]
    given = np.stack([np.asarray(frame.T_world_camera, float) for frame in frames])
    pairs: list[Pair] = []
    for i in range(len(frames)):
        later = (registered(i, j, clouds, given) for j in range(i + 1, len(frames)))
        pairs += [pair for pair in later if pair is not None]
        if progress is not None:
            progress(i + 1, len(frames))
    part = parts(len(frames), pairs)
    if (part != part[0]).any():
        names = ", ".join(frame.name for frame, k in zip(frames, part, strict=True) if k != part[0])
        raise EvaluationError(
            f"frames {names} are not connected with the first by frames that overlap: take more, or leave these out"
        )
    poses = together(given, clouds, pairs)
    return DenseReference(poses, len(pairs), _spread(poses, pairs), _spread(given, pairs))


def _spread(poses: Float[np.ndarray, "n 4 4"], pairs: Sequence[Pair]) -> float:
    ahead = np.array([[0.0, 0.0, AHEAD]])
    off = [
        transformed(np.linalg.inv(poses[pair.i]) @ poses[pair.j] @ pair.T_j_i, ahead) - ahead
        for pair in pairs
    ]
    return float(np.median(np.linalg.norm(off, axis=-1)))
