"""From segments to the masks that loaders read: an image of ids."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from objgraph.segment.mask2former import Segment


def instance_masks(segments: Sequence[Segment], shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """Ids from 1 on in the segments' order; 0 where nothing is."""
    image = np.zeros(shape, dtype=np.uint16)
    for number, segment in enumerate(segments, 1):
        image[segment.mask] = number
    return image


def detection_masks(
    segments: Sequence[Segment],
    boxes: Mapping[int, tuple[str, Float[np.ndarray, "4"]]],
    shape: tuple[int, int],
    least: float = 0.3,
) -> Int[np.ndarray, "h w"]:
    """The same with the ids of detections: each takes the segment of its category whose box agrees best with its own.

    `boxes` has category and (left, top, right, bottom) in pixels by id; below an IoU of `least` two are not the same.
    """
    image = np.zeros(shape, dtype=np.uint16)
    numbers = list(boxes)
    agreement = np.zeros((len(numbers), len(segments)))
    for i, number in enumerate(numbers):
        category, box = boxes[number]
        for j, segment in enumerate(segments):
            if segment.category == category:
                agreement[i, j] = _iou(box, _bounds(segment))
    for i, j in zip(*linear_sum_assignment(-agreement), strict=True):
        if agreement[i, j] >= least:
            image[segments[j].mask] = numbers[i]
    return image


def _bounds(segment: Segment) -> Float[np.ndarray, "4"]:
    v, u = np.nonzero(segment.mask)
    return np.array([u.min(), v.min(), u.max() + 1, v.max() + 1], float)


def _iou(a: Float[np.ndarray, "4"], b: Float[np.ndarray, "4"]) -> float:
    low, high = np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])
    both = np.prod((high - low).clip(min=0.0))
    return float(both / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - both))
