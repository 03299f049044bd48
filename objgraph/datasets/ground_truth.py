"""Ground truth of a scan's objects: for evaluation alone, no estimator sees it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
import trimesh.creation
from jaxtyping import Float, Int

from objgraph.observation.frames import Scan


@dataclass(frozen=True)
class GroundTruth:
    """An annotated CAD model."""

    T_world_object: Float[np.ndarray, "4 4"]
    """Rigid: rotation and translation of the CAD's canonical frame."""
    scale: Float[np.ndarray, "3"]
    """Metres per canonical unit along the object's own axes: p_world = T_world_object (scale * p_object)."""
    vertices: Float[np.ndarray, "v 3"]
    """CAD vertices in its canonical frame (y up, front at -z)."""
    faces: Int[np.ndarray, "f 3"]
    symmetry: int = 1
    """How many rotations about the object's y axis leave it the same; 0 for every angle."""


@dataclass(frozen=True)
class TrueBox(GroundTruth):
    """An annotated box alone: its mesh is the box itself, which tells nothing of the shape in it."""

    quality: str = "full"
    """`full`, or `partial` where whoever annotated it did not see all of its sides."""

    @staticmethod
    def of(
        T_world_object: Float[np.ndarray, "4 4"], size: Float[np.ndarray, "3"], symmetry: int, quality: str
    ) -> "TrueBox":
        """The box about the origin of T_world_object with these edges along the object's axes, metres."""
        cube = trimesh.creation.box()
        return TrueBox(
            T_world_object, size, np.asarray(cube.vertices), np.asarray(cube.faces), symmetry, quality
        )


@dataclass(frozen=True)
class AnnotatedScan(Scan):
    """A scan, and beside it what only the evaluation may read."""

    ground_truth: Mapping[int, GroundTruth] = field(default_factory=dict)
    """By instance id."""
    conditions: Mapping[str, Any] = field(default_factory=dict)
    """What is wrong with the scan and how strongly, where that is known, as JSON values."""


def annotated(scan: Scan) -> AnnotatedScan:
    """The scan with its ground truth, which is empty where the data set has none."""
    if isinstance(scan, AnnotatedScan):
        return scan
    return AnnotatedScan(scan.name, scan.frames, scan.instances, scan.up_world)


class LazyTruth(Mapping[int, GroundTruth]):
    """Ground truth that is read when the evaluation first asks for it; mapping never pays for it."""

    def __init__(self, read: Callable[[], dict[int, GroundTruth]]) -> None:
        self._read = read

    @cached_property
    def _truth(self) -> dict[int, GroundTruth]:
        return self._read()

    def __getitem__(self, instance_id: int) -> GroundTruth:
        return self._truth[instance_id]

    def __iter__(self) -> Iterator[int]:
        return iter(self._truth)

    def __len__(self) -> int:
        return len(self._truth)
