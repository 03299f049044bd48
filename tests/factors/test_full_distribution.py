"""What a metre of a ray counts, by loops over its parts."""

import gtsam
import numpy as np
import pytest
import torch

from factors.base import Annealing
from factors.depth import DepthFactor, RaySampling
from factors.full_distribution import FullDistribution
from factors.rays import RayCells, Rays
from factors.rendering import ESCAPE, RaySamples, RayTargets
from factors.state import ObjectKeys, ObjectState
from tests.factors.conftest import CODE_LENGTH, SphereDecoder


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
    edges = [
        (float(d - w / 2), float(d + w / 2)) for d, w in zip(cells.depth[r], cells.width[r], strict=True)
    ]
    insides = [(d, max(d, min(e, end))) for d, e in edges]
    if reach is None:
        return [e - d for d, e in insides], lengths
    low, high = at - reach * spread, at + reach * spread
    close = [within(*way, low, high) if length else 0.0 for way, length in zip(ways, lengths, strict=True)]
    rest = [length - some for length, some in zip(lengths, close, strict=True)]
    front = sum(within(d, e, -np.inf, low) for d, e in insides) + rest[1]
    back = sum(within(d, e, high, np.inf) for d, e in insides) + rest[0] + rest[2]
    shares = {
        side: min(1.0, spread / length) if length > 0 else 1.0 for side, length in [("f", front), ("b", back)]
    }
    weights = [
        within(d, e, low, high)
        + shares["f"] * within(d, e, -np.inf, low)
        + shares["b"] * within(d, e, high, np.inf)
        for d, e in insides
    ]
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


@pytest.mark.parametrize("shift", [0.1, 0.14, 0.15, 0.16, 0.2, 0.3])
@pytest.mark.parametrize("slope", [120.0, 400.0])
def test_how_finely_a_ray_is_cut_is_of_no_matter_to_what_a_wrong_place_costs(slope, shift):
    """A sphere that stands behind the hits on it, its box's near side right before them or not."""
    keys, values = ObjectKeys.numbered(0), gtsam.Values()
    across = np.random.default_rng(1).uniform(-0.1, 0.1, (30, 2))
    directions = np.column_stack([across, np.ones(30)])
    squared = np.square(directions).sum(axis=1)
    depth = (2.5 - np.sqrt(2.5**2 - squared * (2.5**2 - 0.4**2))) / squared
    rays = Rays(directions, depth, np.ones(30, dtype=bool), np.full(30, np.inf), np.full(30, 0.01))
    pose = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 2.5 + shift]))
    ObjectState(pose, np.zeros(3), np.zeros(CODE_LENGTH)).insert(values, keys)
    losses = []
    for sampling in (RaySampling(), RaySampling(coarse=100, cells=400)):
        factor = DepthFactor(keys, SphereDecoder(), gtsam.Pose3(), rays, prior_sigma=0.003, sampling=sampling)
        factor.refresh(values, Annealing(slope))
        losses.append(factor.loss(values))
    assert losses[0] == pytest.approx(losses[1], rel=0.05)
