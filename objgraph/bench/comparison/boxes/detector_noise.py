"""Detections with more or less noise than they have: how much it matters that a graph is told another one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from objgraph.bench.comparison.boxes.matching import LabelledBox
from objgraph.observation.lidar.frame import Detection


def scaled(
    detections: Sequence[Detection], matched: Mapping[int, LabelledBox], factor: float
) -> tuple[Detection, ...]:
    """Detections whose errors are `factor` times what they were: in place, rotation and the logarithm of each edge.

    This makes the data and comes before all estimation: another detector is stood in for, as the detections that are there
    were made of labels and noise themselves. An estimator sees what comes out alone. Those without a label stay.
    """
    if factor == 1.0:
        return tuple(detections)
    return tuple(
        each if (label := matched.get(each.id)) is None else _scaled(each, label, factor)
        for each in detections
    )


def _scaled(detection: Detection, label: LabelledBox, factor: float) -> Detection:
    T, true = detection.T_world_object, label.T_world_object
    error = Rotation.from_matrix(true[:3, :3].T @ T[:3, :3]).as_rotvec()
    T_world_object = np.eye(4)
    T_world_object[:3, :3] = true[:3, :3] @ Rotation.from_rotvec(factor * error).as_matrix()
    T_world_object[:3, 3] = true[:3, 3] + factor * (T[:3, 3] - true[:3, 3])
    size = label.size * (detection.size / label.size) ** factor
    return replace(detection, T_world_object=T_world_object, size=size)
