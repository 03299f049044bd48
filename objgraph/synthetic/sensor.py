"""The faults of a structured-light depth camera and of a segmentation network.

Axial and lateral noise: Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and
Tracking", 3DIMPVT 2012. Disparity steps: Barron, Malik, "Intrinsic Scene Properties from a Single RGB-D Image",
CVPR 2013.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage


@dataclass(frozen=True)
class SensorConfig:
    """Strengths of the faults; zeros give the perfect sensor."""

    axial_base_m: float = 0.0012
    """Standard deviation of depth at 0.4 m."""
    axial_growth: float = 0.0019
    """Its growth with (z - 0.4 m)^2, per metre."""
    correlation_px: float = 0.8
    """Standard deviation of the Gaussian over which neighbours share their noise."""
    quantum: float = 0.00285
    """Depth step at one metre; it grows with z^2 as disparities of an eighth of a pixel do."""
    lateral_px: float = 0.6
    """Standard deviation of the shift, in pixels, with which depth edges are read."""
    grazing_rad: tuple[float, float] = (1.3, 1.5)
    """Angles of incidence between which depth goes from always there to never there."""
    edge_dropout: float = 0.15
    """Share of the pixels at depth edges that lose their depth."""
    range_m: tuple[float, float] = (0.4, 6.0)
    """Nearest and farthest depth that is measured."""
    mask_px: float = 0.5
    """Standard deviation of the displacement of the masks' borders along each axis, in pixels of the image itself, before it is
    rounded to whole ones."""
    edge_jump_m: float = 0.05
    """A pixel lies at a depth edge where its 3x3 neighbourhood spans more than this."""


def sense_depth(
    depth: Float[np.ndarray, "h w"],
    incidence: Float[np.ndarray, "h w"],
    config: SensorConfig,
    rng: np.random.Generator,
) -> Float[np.ndarray, "h w"]:
    """Measured z-depth in metres, 0 where there is none, of the true depth (0 where nothing is hit)."""
    edge = ndimage.maximum_filter(depth, 3) - ndimage.minimum_filter(depth, 3) > config.edge_jump_m
    z = np.where(edge, _displace(depth, rng.normal(0, config.lateral_px, (2, *depth.shape))), depth)
    z = np.where(
        z > 0, z + _axial_sigma(z, incidence, config) * _noise(z.shape, config.correlation_px, rng), 0
    )
    measured = _quantise(z, config.quantum)
    lost = rng.random(z.shape) < _loss(incidence, edge, config)
    near, far = config.range_m
    return np.where(lost | (measured < near) | (measured > far), 0.0, measured)


def sense_masks(
    instances: Int[np.ndarray, "h w"],
    config: SensorConfig,
    rng: np.random.Generator,
    correlation_px: float = 2.5,
) -> Int[np.ndarray, "h w"]:
    """The masks with their borders moved, alike over `correlation_px` of the border, by about `config.mask_px` along either axis."""
    shift = np.stack([config.mask_px * _noise(instances.shape, correlation_px, rng) for _ in range(2)])
    return _displace(instances, shift)


def _axial_sigma(z: np.ndarray, incidence: np.ndarray, config: SensorConfig) -> np.ndarray:
    if config.axial_base_m == 0 and config.axial_growth == 0:
        return np.zeros_like(z)
    # Nguyen et al., eq. 3: the last term counts from 60 degrees of incidence on
    steep = np.clip(incidence, 0, 1.45)
    tilt = 1e-4 / np.sqrt(np.maximum(z, 0.1)) * steep**2 / (np.pi / 2 - steep) ** 2
    return config.axial_base_m + config.axial_growth * (z - 0.4) ** 2 + np.where(steep > np.pi / 3, tilt, 0)


def _quantise(z: np.ndarray, quantum: float) -> np.ndarray:
    """Depths that a whole number of disparity steps gives."""
    if quantum == 0:
        return z
    steps = np.round(1 / (quantum * np.maximum(z, 0.05)))
    return np.where(z > 0, 1 / (quantum * np.maximum(steps, 1)), 0.0)


def _loss(incidence: np.ndarray, edge: np.ndarray, config: SensorConfig) -> np.ndarray:
    """Probability of no depth, a pixel."""
    begin, end = config.grazing_rad
    grazing = np.clip((incidence - begin) / (end - begin), 0, 1)
    return np.maximum(grazing, config.edge_dropout * edge)


def _noise(shape: tuple[int, ...], correlation_px: float, rng: np.random.Generator) -> np.ndarray:
    """Normal noise of unit variance, shared by neighbours."""
    white = rng.normal(size=shape)
    if correlation_px == 0:
        return white
    reach = max(16, int(4 * correlation_px) + 1)
    impulse = np.zeros((2 * reach + 1, 2 * reach + 1))
    impulse[reach, reach] = 1
    gain = np.linalg.norm(ndimage.gaussian_filter(impulse, correlation_px))
    return ndimage.gaussian_filter(white, correlation_px, mode="wrap") / gain


def _displace(image: np.ndarray, shift: Float[np.ndarray, "2 h w"]) -> np.ndarray:
    """Every pixel read from the one that lies nearest to `shift` (rows, columns) away."""
    h, w = image.shape
    rows = np.clip(np.round(np.arange(h)[:, None] + shift[0]), 0, h - 1).astype(int)
    columns = np.clip(np.round(np.arange(w) + shift[1]), 0, w - 1).astype(int)
    return image[rows, columns]
