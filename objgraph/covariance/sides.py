"""How far the sides of a real object's box lie from those of the shape that was fitted: little where a side was seen."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from factors import checks
from factors.checks import PLACES
from factors.state import ObjectState
from objgraph.errors import CovarianceError

SEEN_M = 0.06
"""Surface that has a seen point within this distance was seen."""
_OUTER = 0.08
"""Share of the extent within which surface belongs to a side."""
_SHARES = checks.Range(0, 1)


@dataclass(frozen=True)
class SideMisfit:
    """What no covariance of pose, scale and code knows of: the prior's shapes are not the real ones.

    Each side of the box errs on its own, with a standard deviation that goes from `seen`, of one that was seen whole, to `unseen`
    times the extent, in equal steps of its logarithm over the share that was seen. Of two sides that err apart, centre and extent
    err together. It is measured (`objgraph calibrate`).

    Raises:
        CovarianceError: one of the numbers is not positive.
    """

    marginals: float
    """Factor on the variances that the marginals give the box."""
    seen: float
    """Metres."""
    unseen: float
    """Share of the extent."""

    def __post_init__(self) -> None:
        for name in ("marginals", "seen", "unseen"):
            checks.number(f"the sides' {name}", getattr(self, name), checks.POSITIVE, CovarianceError)

    def sigma(
        self, extents: Float[np.ndarray, "... 3"], seen: Float[np.ndarray, "... 3 2"]
    ) -> Float[np.ndarray, "... 3 2"]:
        """Standard deviations of the lower and the upper side along each axis, metres."""
        widest = np.log(np.maximum(self.unseen * np.asarray(extents)[..., None], self.seen))
        return np.exp(seen * np.log(self.seen) + (1 - seen) * widest)

    def matrix(
        self, extents: Float[np.ndarray, "... 3"], seen: Float[np.ndarray, "... 3 2"]
    ) -> Float[np.ndarray, "... 9 9"]:
        """What the sides' errors add to a box's covariance, over `BOX_AXES`; `seen` is the share of each side that was."""
        lower, upper = np.moveaxis(np.square(self.sigma(extents, seen)), -1, 0)
        matrix = np.zeros((*np.shape(extents)[:-1], 9, 9))
        for axis in range(3):
            edge = np.asarray(extents)[..., axis]
            both, apart = lower[..., axis] + upper[..., axis], upper[..., axis] - lower[..., axis]
            matrix[..., 3 + axis, 3 + axis] = both / 4
            matrix[..., 6 + axis, 6 + axis] = both / edge**2
            matrix[..., 3 + axis, 6 + axis] = matrix[..., 6 + axis, 3 + axis] = apart / (2 * edge)
        return matrix

    def widened(
        self,
        marginals: Float[np.ndarray, "... 9 9"],
        extents: Float[np.ndarray, "... 3"],
        seen: Float[np.ndarray, "... 3 2"],
    ) -> Float[np.ndarray, "... 9 9"]:
        """A box's covariance, by the marginals, with these errors."""
        return self.marginals * np.asarray(marginals) + self.matrix(extents, seen)


def seen_vertices(
    vertices_world: Float[np.ndarray, "v 3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "v"]:
    """Which vertices of a surface have a seen point near them."""
    points = points_world[np.isfinite(points_world).all(axis=1)]
    if not len(points):
        return np.zeros(len(vertices_world), bool)
    return cKDTree(points).query(vertices_world, distance_upper_bound=SEEN_M)[0] < SEEN_M


def seen_sides(
    state: ObjectState,
    vertices_world: Float[np.ndarray, "v 3"],
    seen: Bool[np.ndarray, "v"],
    stands: bool = False,
) -> Float[np.ndarray, "3 2"]:
    """Share of the surface at the lower and the upper side of each of the box's axes that was seen.

    An object that `stands` on a floor that is known has its lower side where the floor is.

    Raises:
        CovarianceError: there are no vertices.
    """
    p_object = state.to_object(
        checks.reals("vertices_world", vertices_world, (None, 3), PLACES, CovarianceError)
    )
    if not len(p_object):
        raise CovarianceError("a surface without vertices has no sides")
    low, high = p_object.min(axis=0), p_object.max(axis=0)
    shares = np.zeros((3, 2))
    for axis in range(3):
        margin = _OUTER * (high[axis] - low[axis])
        for end, at in enumerate(
            (p_object[:, axis] <= low[axis] + margin, p_object[:, axis] >= high[axis] - margin)
        ):
            shares[axis, end] = seen[at].mean()
    if stands:
        shares[1, 0] = 1.0
    return shares
