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
    radius = round(pixels(faults.mask_thin_px, width) / 2)
    if radius > 0:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        for number in np.unique(masks[masks > 0]):
            mask = (masks == number).astype(np.uint8)
            masks[(mask > 0) & (cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel) == 0)] = 0
    # along rows and columns together it is what the fault says
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
