"""Where a camera was: the chain of transforms from a world to its frame, from tf, odometry or poses."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from objgraph.datasets.trajectory import Trajectory, interpolate
from objgraph.errors import DatasetError

WORLDS = ("map", "odom", "world")
"""Frames whose z axis is up (REP 103 and 105)."""
Row = tuple[float, ...]
"""tx ty tz qx qy qz qw."""


class Transforms:
    """Transforms between named frames over time; each frame has one parent."""

    def __init__(self, origin: object) -> None:
        self._origin = origin
        self._moving: dict[str, dict[str, dict[float, Row]]] = defaultdict(lambda: defaultdict(dict))
        self._fixed: dict[str, dict[str, Row]] = defaultdict(dict)

    def add(self, child: str, parent: str, seconds: float | None, transform: Any) -> None:
        """A Transform or Pose message, parent from child; seconds are None for one that never changes."""
        translation = getattr(transform, "translation", None) or transform.position
        rotation = getattr(transform, "rotation", None) or transform.orientation
        row = (translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w)
        if seconds is None:
            self._fixed[child][parent] = row
        else:
            self._moving[child][parent][seconds] = row

    def replaced_by(self, other: "Transforms") -> "Transforms":
        """These, with what the other says of a frame in place of what these do."""
        both = Transforms(self._origin)
        both._moving.update(self._moving)
        both._fixed.update((child, row) for child, row in self._fixed.items() if child not in other._moving)
        both._moving.update(other._moving)
        return both

    def chain(self, frame: str) -> list[str]:
        """The frame, its parent, the parent's parent and so on.

        Raises:
            DatasetError: a frame has two parents, or is above itself.
        """
        frames = [frame]
        while parents := self._moving.get(frames[-1]) or self._fixed.get(frames[-1]):
            if len(parents) > 1:
                raise DatasetError(
                    f"{self._origin}: frame {frames[-1]} has several parents ({', '.join(sorted(parents))}): say by "
                    "pose_topic (--topic.pose) where the camera is"
                )
            parent = next(iter(parents))
            if parent in frames:
                raise DatasetError(
                    f"{self._origin}: frames go round in a circle: {' < '.join(frames)} < {parent}"
                )
            frames.append(parent)
        return frames

    def moves(self, chain: Sequence[str]) -> bool:
        """Whether anything along it does."""
        return any(child in self._moving for child in chain[:-1])

    def poses(
        self, chain: Sequence[str], times: Float[np.ndarray, "n"], max_difference: float
    ) -> Float[np.ndarray, "n 4 4"]:
        """The chain's last frame from its first, at times in seconds; NaN where one of its links is not known.

        Raises:
            DatasetError: a transform is none.
        """
        T = np.tile(np.eye(4), (len(times), 1, 1))
        for child, parent in pairwise(chain):
            where = f"{self._origin}: the transform from {child} to {parent}"
            if child in self._moving:
                rows = dict(sorted(self._moving[child][parent].items()))
                trajectory = Trajectory(np.array(list(rows)), _matrices(list(rows.values()), where))
                T = interpolate(trajectory, times, max_difference) @ T
            else:
                T = _matrices([self._fixed[child][parent]], where) @ T
        return T


def camera_chain(
    tf: Transforms,
    others: Mapping[str, Transforms],
    camera: str,
    world: str | None,
    origin: object,
    named: bool = False,
) -> tuple[str, Transforms, list[str]]:
    """Who places the camera ("tf" or a topic), the transforms, and its chain of frames up to the world.

    tf's own where they reach the world (that named, else one called map, odom or world), otherwise, or where they are
    `named`, with those of the one other topic. Where there is none, tf's end is the world if the camera moves in it.

    Raises:
        DatasetError: nothing places the camera, several topics may, or the chain does not reach the world.
    """
    chain = tf.chain(camera)
    reached = world in chain if world else any(frame in WORLDS for frame in chain)
    reached = reached or (not world and not others and tf.moves(chain))  # a robot's joints move, too
    if reached and not named:
        return "tf", tf, _up_to(chain, world)
    if len(others) != 1:
        found = f"{', '.join(others)} may say" if others else "nothing says"
        raise DatasetError(
            f"{origin}: {found} where the camera (frame {camera}) was in {world or 'the world'}; tf has "
            f"{' < '.join(chain)}; name a topic by pose_topic (--topic.pose) or a file by trajectory (--trajectory)"
        )
    (topic, other), *_ = others.items()
    tf = tf.replaced_by(other)
    chain = tf.chain(camera)
    if not any(child in other._moving for child in chain[:-1]):
        raise DatasetError(
            f"{origin}: {topic} is of frame {', '.join(other._moving) or 'without a name'}, and nothing leads from there to the camera's, "
            f"{camera}; tf has {' < '.join(chain)}"
        )
    if world and world not in chain:
        raise DatasetError(f"{origin}: no chain from {camera} to {world}; there is {' < '.join(chain)}")
    return topic, tf, _up_to(chain, world)


def _up_to(chain: list[str], world: str | None) -> list[str]:
    if world is None:
        known = [frame for frame in chain if frame in WORLDS]
        world = known[-1] if known else chain[-1]
    return chain[: chain.index(world) + 1]


def _matrices(rows: Sequence[Row], where: str) -> Float[np.ndarray, "n 4 4"]:
    numbers = np.array(rows, float)
    lengths = np.linalg.norm(numbers[:, 3:], axis=1)
    if not np.isfinite(numbers).all() or np.abs(lengths - 1).max() > 1e-2:
        raise DatasetError(f"{where} holds NaN, or a quaternion that is not of length 1")
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(numbers[:, 3:]).as_matrix()
    T[:, :3, 3] = numbers[:, :3]
    return T
