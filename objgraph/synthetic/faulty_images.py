"""Masks as networks make them and depth as cameras do, beyond the sensor model of `objgraph.synthetic.sensor`."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator
from scipy import ndimage

from objgraph.synthetic.faults import Faults, pixels
from objgraph.synthetic.sensor import SensorConfig, sense_depth, sense_masks

_BORDER_PX = 16.0
"""Over which a mask's border is displaced alike, in an image 640 pixels wide."""
_STEP_M = 0.05
"""Fusion smooths over smaller steps of depth, and leaves larger ones."""


def faulty_masks(
    instances: Int[np.ndarray, "h w"], target: int, faults: Faults, rng: Generator
) -> Int[np.ndarray, "h w"]:
    """The instance image with the target's mask (and thin parts of all) as wrong as the faults say."""
    width = instances.shape[1]
    masks = instances.copy()
    if faults.merged:
        neighbour = _touching(masks, target)
        masks[masks == neighbour] = target
    if rng.random() < 0.5:
        masks[_part(masks == target, faults.mask_part, rng)] = 0
    else:
        beside = ndimage.binary_dilation(masks == target, iterations=max(1, round(pixels(40, width))))
        masks[_grown(masks == target, beside, faults.mask_part, rng)] = target
    masks = _without_thin(masks, pixels(faults.mask_thin_px, width))
    # rows and columns together are what the fault says: across itself a border moves by 0.71 of it
    border = SensorConfig(mask_px=pixels(faults.mask_border_px, width) / np.sqrt(2))
    return sense_masks(masks, border, rng, pixels(_BORDER_PX, width))


def faulty_depth(
    depth: Float[np.ndarray, "h w"],
    incidence: Float[np.ndarray, "h w"],
    dark: Bool[np.ndarray, "h w"],
    faults: Faults,
    sensor: SensorConfig,
    rng: Generator,
) -> Float[np.ndarray, "h w"]:
    """Measured z-depth, metres, 0 where there is none; `dark` gives none, and what the sensor loses does not fly."""
    smooth = _fused(depth, pixels(faults.fusion_px, depth.shape[1]))
    strong = replace(
        sensor,
        axial_base_m=sensor.axial_base_m * faults.sensor,
        axial_growth=sensor.axial_growth * faults.sensor,
        quantum=sensor.quantum * faults.sensor,
        lateral_px=sensor.lateral_px * faults.sensor,
        edge_dropout=min(1.0, sensor.edge_dropout * faults.sensor),
    )
    measured = sense_depth(smooth, incidence, strong, rng)
    # before the sensor: its noise would make edges, and what it loses would hide them
    near, far = sensor.range_m
    there = (smooth >= near) & (smooth <= far)
    front = ndimage.minimum_filter(np.where(there, smooth, far), 3)
    behind = ndimage.maximum_filter(np.where(there, smooth, 0.0), 3)
    edge = (measured > 0) & (behind - front > sensor.edge_jump_m)
    flying = edge & (rng.random(depth.shape) < faults.flying)
    measured = np.where(flying, front + rng.random(depth.shape) * (behind - front), measured)
    return np.where(dark, 0.0, measured)


def _without_thin(masks: Int[np.ndarray, "h w"], width: float) -> Int[np.ndarray, "h w"]:
    """Of every mask what discs within it cover that are `width` pixels wide, any number; no mask ends where the picture does."""
    reach = int(np.ceil(width)) + 1
    wide = np.pad(masks, reach, mode="edge")
    kept = np.zeros_like(wide)
    for number, at in enumerate(ndimage.find_objects(wide), 1):
        if at is not None:
            kept[at][_opened(wide[at] == number, width)] = number
    return kept[reach:-reach, reach:-reach]


def _opened(mask: Bool[np.ndarray, "h w"], width: float) -> Bool[np.ndarray, "h w"]:
    """What discs of a diameter in pixels cover that lie within a mask."""
    # pixels' middles, edges and corners: a strip of any number of pixels has a middle line among them
    halves = np.pad(np.repeat(np.repeat(mask, 2, axis=0), 2, axis=1), 1)
    inside = halves[1:, 1:] & halves[1:, :-1] & halves[:-1, 1:] & halves[:-1, :-1]
    middles = np.asarray(ndimage.distance_transform_edt(inside)) >= width
    if not middles.any():
        return np.zeros_like(mask)
    covered = np.asarray(ndimage.distance_transform_edt(~middles)) <= width
    return mask & covered[1::2, 1::2]


def _touching(masks: Int[np.ndarray, "h w"], target: int) -> int:
    """The other mask with the longest common border; -1 where there is none."""
    mask = masks == target
    ring = ndimage.binary_dilation(mask, iterations=2) & ~mask
    numbers, counts = np.unique(masks[ring & (masks > 0)], return_counts=True)
    return int(numbers[np.argmax(counts)]) if len(numbers) else -1


def _part(mask: Bool[np.ndarray, "h w"], share: float, rng: Generator) -> Bool[np.ndarray, "h w"]:
    """What lies nearest to a pixel of the mask, as large a part of it."""
    v, u = np.nonzero(mask)
    count = int(share * len(v))
    part = np.zeros_like(mask)
    if count:
        middle = rng.integers(len(v))
        nearest = np.argsort((v - v[middle]) ** 2 + (u - u[middle]) ** 2, kind="stable")[:count]
        part[v[nearest], u[nearest]] = True
    return part


def _grown(
    mask: Bool[np.ndarray, "h w"], beside: Bool[np.ndarray, "h w"], share: float, rng: Generator
) -> Bool[np.ndarray, "h w"]:
    """As many pixels beside the mask, next to a place on its border."""
    rim = np.argwhere(mask & ~np.asarray(ndimage.binary_erosion(mask), dtype=bool))
    v, u = np.nonzero(beside & ~mask)
    part = np.zeros_like(mask)
    count = min(int(share * mask.sum()), len(v))
    if count and len(rim):
        row, column = rim[rng.integers(len(rim))]
        nearest = np.argsort((v - row) ** 2 + (u - column) ** 2, kind="stable")[:count]
        part[v[nearest], u[nearest]] = True
    return part


def _fused(depth: Float[np.ndarray, "h w"], sigma_px: float) -> Float[np.ndarray, "h w"]:
    """Smoothed over what lies at about one depth; what was not hit stays so."""
    if sigma_px < 0.1:
        return depth
    smooth = cv2.bilateralFilter(depth.astype(np.float32), -1, _STEP_M, sigma_px).astype(float)
    return np.where(depth > 0, smooth, 0.0)
