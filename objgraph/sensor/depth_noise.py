"""How far a patch of surface lies off in a depth image: not a pixel's noise, but what all of a patch's pixels share."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from objgraph.geometry.frames import transformed
from objgraph.geometry.voxels import voxel_keys
from objgraph.observation.sampling import SensorNoise
from objgraph.sensor.registration import Cloud, Pair

_ENOUGH = 15
"""Points of a patch in either frame."""
_FLAT = 0.1
"""Thickness of a patch that is a plane, as a share of its width."""
_SLANT = 0.5
"""Least cosine between a patch's normal and its ray."""
_REACH = 0.05
"""Metres off a patch's plane beyond which a point is of something else."""
_LEAST = 1e-4
"""Metres, and 1/metres: no sensor is better."""
_MEDIAN = 0.6745
"""Of the absolute value of a standard normal variable."""


def patch_offsets(pair: Pair, clouds: Sequence[Cloud], edge: float) -> Float[np.ndarray, "m 3"]:
    """Planes of frame i that frame j sees too, in cubes of that edge: how far j has them off, along their normal, and their
    depth in i and in j; metres."""
    p_i, p_j = np.asarray(clouds[pair.i].points), np.asarray(clouds[pair.j].points)
    tree = cKDTree(p_j)
    _, cube, count = np.unique(voxel_keys(p_i, edge), return_inverse=True, return_counts=True)
    found = []
    for k in np.flatnonzero(count >= _ENOUGH):
        points = p_i[cube.ravel() == k]
        middle = points.mean(axis=0)
        variances, axes = np.linalg.eigh(np.cov(points.T))
        normal = axes[:, 0]
        slanted = abs(normal @ middle) < _SLANT * np.linalg.norm(middle)
        if slanted or variances[0] > _FLAT**2 * variances[1]:
            continue
        middle_j = transformed(pair.T_j_i, middle[None])[0]
        normal_j = pair.T_j_i[:3, :3] @ normal
        around = p_j[tree.query_ball_point(middle_j, edge / 2)] - middle_j
        off = around @ normal_j
        around, off = around[np.abs(off) < _REACH], off[np.abs(off) < _REACH]
        # of a patch that j sees in part only, the plane's tilt would count as an offset
        if len(off) < _ENOUGH or np.linalg.norm(around.mean(axis=0) - off.mean() * normal_j) > edge / 6:
            continue
        found.append((off.mean(), middle[2], middle_j[2]))
    return np.array(found).reshape(-1, 3)


def fitted_noise(offsets: Float[np.ndarray, "m 3"]) -> SensorNoise:
    """The noise of one frame of which the offsets between two are the difference.

    An offset's deviation is `hypot(s(z_i), s(z_j))`; regression to the median, so that what moved or is no plane counts little.
    """
    off, z_i, z_j = offsets.T
    size = np.abs(off) / _MEDIAN

    def misfit(logs: Float[np.ndarray, "2"]) -> float:
        noise = _noise(logs)
        return float(np.abs(np.log(size + 1e-6) - np.log(np.hypot(noise(z_i), noise(z_j)) + 1e-6)).mean())

    # the median of the logarithm is the logarithm of the median: regression on logarithms weighs near and far alike
    starts = [np.log([base, quadratic]) for base in (1e-3, 1e-2) for quadratic in (1e-4, 3e-3)]
    best = min((minimize(misfit, start, method="Nelder-Mead") for start in starts), key=lambda r: r.fun)
    return _noise(best.x)


def _noise(logs: Float[np.ndarray, "2"]) -> SensorNoise:
    base, quadratic = np.exp(np.clip(logs, np.log(_LEAST), 0.0))
    return SensorNoise(float(base), float(quadratic))
