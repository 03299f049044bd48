"""The assignment of all detections of a frame at once: they share the error of one camera.

In whitened coordinates w ~ N(0, I) of the camera's error the offset of a pair is y = L w + e, with an e of its own
(objects are taken as independent given the camera). One match therefore says how the others must lie, and what each
costs is its density given them. Every allowed pair is tried as the first of an assignment (as in the joint
compatibility test of Neira and Tardos, 2001, but with one assignment problem a branch); the cheapest whole is taken.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import linear_sum_assignment

from objgraph.slam.association.gate import Fit, PairIndex
from objgraph.slam.association.types import AssociationConfig


def assign(fits: Mapping[PairIndex, Fit], config: AssociationConfig) -> dict[int, int]:
    """The object of each detection in the cheapest assignment; those for which a new object is cheaper are absent."""
    tried = [_solved({pair: fit.cost(config) for pair, fit in fits.items()})]
    if len(fits) > 1 and any(np.any(fit.shared) for fit in fits.values()):
        tried += [[first, *_solved(_given(first, fits, config))] for first in fits]
    tried = [_pruned(chosen, fits, config) for chosen in tried]
    return dict(sorted(min(tried, key=lambda chosen: _cost(chosen, fits, config))))


def camera_error(chosen: Sequence[PairIndex], fits: Mapping[PairIndex, Fit]) -> Float[np.ndarray, "6"]:
    """The camera's whitened error, as far as these pairs tell it."""
    along, covariance, shared = _stacked([fits[pair] for pair in chosen])
    return shared.T @ np.linalg.solve(covariance, along)


def _given(
    first: PairIndex, fits: Mapping[PairIndex, Fit], config: AssociationConfig
) -> dict[PairIndex, float]:
    """What the pairs that leave `first` alone cost, once it has told where the camera is."""
    known = fits[first]
    gain = np.linalg.solve(known.covariance, known.shared).T
    mean = gain @ known.along
    explained = gain @ known.shared
    cost = {}
    for pair, fit in fits.items():
        if pair[0] != first[0] and pair[1] != first[1]:
            covariance = fit.covariance - fit.shared @ explained @ fit.shared.T
            given = fit.seen_as(fit.along - fit.shared @ mean, covariance)
            if given.squared <= fit.limit(config):
                cost[pair] = given.cost(config)
    return cost


def _solved(cost: Mapping[PairIndex, float]) -> list[PairIndex]:
    """The cheapest assignment of independent pairs; a detection without a pair costs nothing."""
    rows, columns = (sorted({pair[side] for pair in cost}) for side in (0, 1))
    matrix = np.full((len(rows), len(columns) + len(rows)), np.inf)
    for (i, j), value in cost.items():
        matrix[rows.index(i), columns.index(j)] = value
    matrix[np.arange(len(rows)), len(columns) + np.arange(len(rows))] = 0.0
    chosen = zip(*linear_sum_assignment(matrix), strict=True)
    return [(rows[r], columns[c]) for r, c in chosen if c < len(columns)]


def _pruned(
    chosen: Sequence[PairIndex], fits: Mapping[PairIndex, Fit], config: AssociationConfig
) -> list[PairIndex]:
    """Without the pairs that a new object is cheaper than, given the others."""
    left, cost = list(chosen), _cost(chosen, fits, config)
    while left:
        fewer = [[pair for pair in left if pair != out] for out in left]
        costs = [_cost(rest, fits, config) for rest in fewer]
        best = int(np.argmin(costs))
        if costs[best] >= cost:
            break
        left, cost = fewer[best], costs[best]
    return left


def _cost(chosen: Sequence[PairIndex], fits: Mapping[PairIndex, Fit], config: AssociationConfig) -> float:
    """Of all pairs together; `Fit.cost` where there is one."""
    if not chosen:
        return 0.0
    group = [fits[pair] for pair in chosen]
    along, covariance, _ = _stacked(group)
    whole = group[0].seen_as(along, covariance)
    lacking = sum(1 - fit.overlap for fit in group[1:])
    return whole.cost(config) + config.overlap_cost * lacking


def _stacked(
    fits: Sequence[Fit],
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m m"], Float[np.ndarray, "m 6"]]:
    """Offsets of several pairs, their joint covariance, and that with the camera."""
    shared = np.concatenate([fit.shared for fit in fits])
    own = block_diag(*(fit.covariance - fit.shared @ fit.shared.T for fit in fits))
    return np.concatenate([fit.along for fit in fits]), own + shared @ shared.T, shared
