"""How large objects of a category are: the bounding box's diagonal in metres."""

from collections.abc import Sequence

import numpy as np

USUAL = {"chair": (1.17, 0.20), "table": (1.75, 0.40), "car": (5.0, 0.12)}
"""Geometric mean and log-deviation from usual dimensions: chairs from 0.45 x 0.85 x 0.5 (dining) to
0.68 x 1.0 x 0.68 (office); tables from 0.9 x 0.45 x 0.6 (coffee) to 2.8 x 0.75 x 1.2 (meeting); cars from
1.65 x 1.5 x 3.6 (small) to 2.0 x 1.9 x 5.3 (van, pick-up)."""

_PLAUSIBLE = {"chair": (0.4, 4.0), "table": (0.4, 4.0), "car": (3.0, 8.0)}
"""Diagonals beyond these are no metric size of the category, whatever their source says."""
_PLAUSIBLE_ANYTHING = (0.05, 30.0)
_USUAL_COUNT = 10


def size_statistics(category: str, extents: Sequence[tuple[float, float, float]]) -> tuple[float, float, str]:
    """Geometric mean and log-deviation of the diagonal, and a sentence on where they come from.

    Metric originals are counted one each, the table of usual sizes as ten; without either the size is left wide.
    """
    diagonals = np.array([np.linalg.norm(extent) for extent in extents])
    low, high = _PLAUSIBLE.get(category, _PLAUSIBLE_ANYTHING)
    logs = np.log(diagonals[(diagonals > low) & (diagonals < high)])
    known = USUAL.get(category)
    if known is None and len(logs) < 3:
        return 1.0, 0.5, "unknown: too few metric meshes; a wide guess"
    prior_mean, prior_sigma, count = (np.log(known[0]), known[1], _USUAL_COUNT) if known else (0.0, 0.0, 0)
    total = count + len(logs)
    mean = (count * prior_mean + logs.sum()) / total
    variance = (count * (prior_sigma**2 + (prior_mean - mean) ** 2) + ((logs - mean) ** 2).sum()) / total
    source = f"{len(logs)} metric meshes" + (f" and usual dimensions counted as {count}" if known else "")
    return float(np.exp(mean)), float(np.sqrt(variance)), source
