"""Cubes of a grid in space, one integer each."""

import numpy as np
from jaxtyping import Float, Int

_BITS = 21
_OFFSET = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1


def voxel_keys(points: Float[np.ndarray, "n 3"], edge: float) -> Int[np.ndarray, "n"]:
    """The cube of that edge that each point lies in; keys are in the order of their indices along x, then y, then z.

    Indices are of 21 bits, a million cubes to either side, and begin again there: cubes of the same key are two million apart.
    """
    x, y, z = ((np.floor(points / edge).astype(np.int64) + _OFFSET) & _MASK).T
    return (x << 2 * _BITS) | (y << _BITS) | z


def voxel_indices(keys: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n 3"]:
    """The indices of cubes along the axes."""
    return np.stack([keys >> 2 * _BITS, (keys >> _BITS) & _MASK, keys & _MASK], axis=1) - _OFFSET
