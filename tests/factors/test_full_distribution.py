"""What a metre of a ray counts, by loops over its parts."""

import numpy as np
import pytest
import torch

from factors.full_distribution import FullDistribution
from factors.rays import RayCells
from factors.rendering import ESCAPE, RaySamples, RayTargets


def rays_of_all_kinds(rng: np.random.Generator, count: int = 60, cells: int = 7) -> RaySamples:
    """Hits before, in and behind the box, and free rays, some of which end in it."""
    width = rng.uniform(0.02, 0.1, (count, cells))
    edges = torch.as_tensor(np.cumsum(np.c_[rng.uniform(1, 1.2, count), width], axis=1))
    depth, hit = torch.as_tensor(rng.uniform(0.7, 2.2, count)), torch.as_tensor(rng.random(count) < 0.7)
    end = torch.where(hit, depth + 2.0, depth + torch.as_tensor(rng.uniform(-0.2, 0.3, count)))
    targets = RayTargets(depth, hit, end, torch.full_like(depth, 0.01))
    sdf = torch.as_tensor(rng.normal(size=(count, cells)) * 0.05)
    middles = 0.5 * (edges[:, 1:] + edges[:, :-1])
    return RaySamples(sdf, 0.02 + 0 * sdf, RayCells(middles, edges.diff(dim=1), edges[:, -1]), targets, 90.0)


def within(low: float, high: float, near: float, far: float) -> float:
    """Length of what two intervals share."""
    return max(0.0, min(high, far) - max(low, near))


def by_loops(
    reach: float | None, samples: RaySamples, r: int, spread: float
) -> tuple[list[float], list[float]]:
    """Weights of the cells; of the way from a hit to the box, from the box to the depth, and from there to the end."""
    cells, targets = samples.cells, samples.targets
    at, hit, far = float(targets.depth[r]), bool(targets.hit[r]), float(cells.far[r])
    end = min(float(targets.end[r]), ESCAPE * max(far, at))
    near = float(cells.depth[r, 0] - 0.5 * cells.width[r, 0])
    ways = [(at, min(near, end) if hit else at), (far, min(at, end)), (max(far, at), end)]
    lengths = [max(0.0, high - low) for low, high in ways]
    insides = [(float(d), float(w)) for d, w in zip(cells.depth[r], cells.width[r], strict=True)]
    insides = [(d, w if d < end else 0.0) for d, w in insides]
    if reach is None:
        return [w for _, w in insides], lengths
    low, high = at - reach * spread, at + reach * spread
    close = [within(*way, low, high) if length else 0.0 for way, length in zip(ways, lengths, strict=True)]
    rest = [length - some for length, some in zip(lengths, close, strict=True)]
    front = sum(w for d, w in insides if d <= low) + rest[1]
    back = sum(w for d, w in insides if d >= high) + rest[0] + rest[2]
    shares = {
        side: min(1.0, spread / length) if length > 0 else 1.0 for side, length in [("f", front), ("b", back)]
    }
    weights = [w * (1.0 if low < d < high else shares["f" if d < at else "b"]) for d, w in insides]
    outside = [c + x * shares[side] for c, x, side in zip(close, rest, "bfb", strict=True)]
    return weights, outside


@pytest.mark.parametrize("reach", [None, 1.0, 3.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_near_the_depth_counts_by_its_length_and_the_rest_as_one_more_spread(reach, seed):
    rng = np.random.default_rng(seed)
    samples = rays_of_all_kinds(rng)
    spread = torch.as_tensor(rng.uniform(0.01, 0.08, len(samples.sdf)))
    weights = FullDistribution(reach=reach)._weights(samples, spread)
    beyond, before = 0, 0
    for r in range(len(spread)):
        cells, outside = by_loops(reach, samples, r, float(spread[r]))
        np.testing.assert_allclose(weights.cells[r], cells, atol=1e-12)
        np.testing.assert_allclose([weights.before[r], *weights.behind[r]], outside, atol=1e-12)
        before, beyond = before + (outside[0] > 0), beyond + (outside[1] > 0)
    assert before > 3
    assert beyond > 3


@pytest.mark.parametrize("reach", [0.0, -1.0, float("nan")])
def test_a_reach_that_is_none_is_refused(reach):
    with pytest.raises(ValueError, match="reach"):
        FullDistribution(reach=reach)
