"""Which detected box is which labelled one, and how well two boxes agree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from objgraph.geometry.boxes import OrientedBox
from objgraph.observation.lidar.frame import Detection


@dataclass(frozen=True)
class LabelledBox:
    """The ground truth of one object; for the evaluation alone."""

    number: int
    """Its line among the labels, from 1 on."""
    category: str
    T_world_object: Float[np.ndarray, "4 4"]
    size: Float[np.ndarray, "3"]
    """Edges along the object's x, y and z, metres."""

    @property
    def box(self) -> OrientedBox:
        return OrientedBox(self.T_world_object[:3, 3], self.T_world_object[:3, :3], self.size)


@dataclass(frozen=True)
class MatchConfig:
    """How near a detection must be to a label to be of the same object (the paper's filter)."""

    distance: float = 1.0
    """Of the boxes' middles, metres."""
    heading_deg: float = 20.0


def matches(
    detections: Sequence[Detection], labels: Sequence[LabelledBox], config: MatchConfig | None = None
) -> Mapping[int, LabelledBox]:
    """The label of each detection that has one, by the detection's id: as many as can be, and then the nearest."""
    config = config or MatchConfig()
    cost = np.full((len(detections), len(labels)), 1e3)
    for i, detection in enumerate(detections):
        for j, label in enumerate(labels):
            distance = np.linalg.norm(detection.T_world_object[:3, 3] - label.T_world_object[:3, 3])
            turned = heading_between_deg(detection.T_world_object, label.T_world_object)
            same = detection.category == label.category
            if same and distance <= config.distance and turned <= config.heading_deg:
                cost[i, j] = distance
    pairs = zip(*linear_sum_assignment(cost), strict=True)
    return {detections[i].id: labels[j] for i, j in pairs if cost[i, j] < 1e3}


def heading_between_deg(a: Float[np.ndarray, "4 4"], b: Float[np.ndarray, "4 4"]) -> float:
    """Degrees between the directions in which two objects face, 0 to 180."""
    return float(np.degrees(np.arccos(np.clip(a[:3, 2] @ b[:3, 2], -1.0, 1.0))))
