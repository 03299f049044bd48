"""How large objects of a category are: the bounding box's diagonal in metres."""

import logging
from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from objgraph.priors.categories import category_of

log = logging.getLogger(__name__)

USUAL = {
    "chair": (1.17, 0.20),
    "table": (1.75, 0.40),
    "car": (5.0, 0.12),
    "sofa": (2.2, 0.25),
    "bed": (2.75, 0.15),
    "cabinet": (1.5, 0.40),
    "bookshelf": (1.9, 0.30),
    "display": (0.85, 0.40),
    "bathtub": (1.95, 0.12),
    "trash_bin": (0.7, 0.35),
}
"""Geometric mean and log-deviation from usual dimensions, width x height x depth: chairs from 0.45 x 0.85 x 0.5 (dining) to
0.68 x 1.0 x 0.68 (office); tables from 0.9 x 0.45 x 0.6 (coffee) to 2.8 x 0.75 x 1.2 (meeting); cars from
1.65 x 1.5 x 3.6 (small) to 2.0 x 1.9 x 5.3 (van, pick-up); sofas from 0.85 x 0.85 x 0.85 (one seat) to 2.6 x 0.85 x 1.0;
beds from 0.9 x 0.9 x 2.0 to 1.9 x 1.2 x 2.15; cabinets from 0.45 x 0.6 x 0.4 (bedside) to 1.5 x 2.1 x 0.6 (wardrobe);
bookshelves from 0.6 x 0.9 x 0.3 to 1.6 x 2.1 x 0.35; displays from 0.45 x 0.4 x 0.15 (20 inches) to 1.45 x 0.85 x 0.1
(65 inches); bathtubs from 1.4 x 0.55 x 0.7 to 1.9 x 0.65 x 0.9; bins from 0.25 x 0.3 x 0.25 (office) to
0.6 x 1.05 x 0.75 (wheeled)."""

LEAST_SIGMA = 0.05
"""Of the logarithm of a size: few meshes, or equal ones, do not make the next object's known."""
_WIDE_SIGMA, _FEW = 0.5, 3
"""The same where there are fewer meshes than that to say how sizes differ, and nothing else is known."""
_PLAUSIBLE = {"chair": (0.4, 4.0), "table": (0.4, 4.0), "car": (3.0, 6.2)}
"""Diagonals beyond these are no metric size of the category, whatever their source says: a car is no longer than a van."""
_PLAUSIBLE_ANYTHING = (0.05, 30.0)
_MOST = 10.0
"""Meshes that the usual sizes count as, and that no source counts more than: a generator's spread is its author's."""


def source_weights(sources: Sequence[str]) -> Float[np.ndarray, "n"]:
    """What each mesh counts, of the source that it is from: a source with many counts as `_MOST`."""
    counts = Counter(sources)
    return np.array([min(1.0, _MOST / counts[source]) for source in sources])


def size_statistics(
    category: str, extents: Sequence[tuple[float, float, float]], sources: Sequence[str] | None = None
) -> tuple[float, float, str]:
    """Geometric mean and log-deviation of the diagonal, and a sentence on where they come from.

    `extents` are those of metric originals, metres, which are from `sources` (left out: each from its own). Of fewer than three,
    and without usual sizes of the category, the size is left wide.
    """
    sources = [str(i) for i in range(len(extents))] if sources is None else sources
    diagonals = np.array([np.linalg.norm(extent) for extent in extents])
    category = category_of(category)  # a couch is as large as a sofa
    low, high = _PLAUSIBLE.get(category, _PLAUSIBLE_ANYTHING)
    good = (diagonals > low) & (diagonals < high)
    if not good.all():
        log.warning(
            "%s: %d of %d meshes have sizes beyond %g to %g m and say nothing of how large objects are; are these metres?",
            category, np.sum(~good), len(good), low, high,
        )  # fmt: skip
    kept = [source for source, is_good in zip(sources, good, strict=True) if is_good]
    logs, weights = np.log(diagonals[good]), source_weights(kept)
    known = USUAL.get(category)
    if known is None and not len(logs):
        return 1.0, _WIDE_SIGMA, "unknown: no metric meshes; a wide guess"
    if known is None and len(logs) < _FEW:
        return float(np.exp(logs.mean())), _WIDE_SIGMA, f"of {len(logs)} metric meshes alone; a wide guess"
    usual, sigma, count = (np.log(known[0]), known[1], _MOST) if known else (0.0, 0.0, 0.0)
    total = count + weights.sum()
    mean = (count * usual + weights @ logs) / total
    variance = (count * (sigma**2 + (usual - mean) ** 2) + weights @ (logs - mean) ** 2) / total
    words = f"{len(logs)} metric meshes of {len(set(kept))} sources, each counted as {_MOST:g} at most"
    return (
        float(np.exp(mean)),
        max(LEAST_SIGMA, float(np.sqrt(variance))),
        words + (", and usual dimensions as so many" if known else ""),
    )
