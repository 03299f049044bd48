"""Augmentation: smooth changes of proportion that keep a chair a chair."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

Warp = Callable[[Float[np.ndarray, "v 3"]], Float[np.ndarray, "v 3"]]


def random_warp(rng: Generator, axis_scale: float = 0.2, part_scale: float = 0.25) -> Warp:
    """A warp of the canonical box that mirrors in x, keeps vertical lines' order and never folds.

    It scales every axis by up to `axis_scale`, stretches the axis's pieces against each other by up to
    `part_scale` (longer legs under a lower back, a deeper seat), and tapers, shears and sags a little.
    """
    scale = np.exp(rng.uniform(-axis_scale, axis_scale, 3))
    knots = np.linspace(-0.5, 0.5, 6)
    stretch_x = _monotone(rng, knots[:4] + 0.5, part_scale)
    stretch_y = _monotone(rng, knots, part_scale)
    stretch_z = _monotone(rng, knots, part_scale)
    taper, shear, sag = rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(-0.15, 0.15)

    def warp(points: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        x, y, z = points.T
        x = np.sign(x) * stretch_x(np.abs(x)) * (1 + taper * y)
        # only what stands behind leans further, so that the seat stays level
        z = stretch_z(z) + shear * np.clip(y, 0, None) + sag * np.clip(y, 0, None) ** 2
        return np.stack([x, stretch_y(y), z], 1) * scale

    return warp


def _monotone(
    rng: Generator, knots: Float[np.ndarray, "k"], amount: float
) -> Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n"]]:
    """A piecewise linear, rising map of the knots' span that starts where they start."""
    steps = np.diff(knots) * np.exp(rng.uniform(-amount, amount, len(knots) - 1))
    values = knots[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return lambda t: np.interp(t, knots, values)
