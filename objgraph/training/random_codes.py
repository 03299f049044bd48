"""Whether every code that the prior holds for likely has a surface."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

from objgraph.errors import SolveError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior

_STRIDES = (8, 4)
"""Of the sparse nodes tried first, in cells."""
_TOGETHER = 16
"""Codes decoded together."""


@dataclass(frozen=True)
class RandomCodes:
    """How many random codes gave no mesh."""

    count: int
    failed: int
    within: float
    """Standard deviations, along each axis of the codes' covariance, beyond which a coordinate is drawn again."""
    resolution: int
    """Cells an axis of the marching cubes."""
    seed: int


def draw_codes(prior: ShapePrior, count: int, within: float = 2.0, seed: int = 0) -> Float[np.ndarray, "n l"]:
    """Codes of the prior's Gaussian whose whitened coordinates all lie within `within` standard deviations.

    Whitened along the covariance's eigenvectors; a coordinate beyond is drawn again.
    """
    rng = np.random.default_rng(seed)
    variances, axes = np.linalg.eigh(np.asarray(prior.code_covariance, float))
    whitened = rng.normal(size=(count, len(variances)))
    while (beyond := np.abs(whitened) > within).any():
        whitened[beyond] = rng.normal(size=np.count_nonzero(beyond))
    return prior.code_mean + whitened * np.sqrt(np.maximum(variances, 0.0)) @ axes.T


def check_random_codes(
    prior: ShapePrior,
    count: int = 1000,
    within: float = 2.0,
    resolution: int = 64,
    seed: int = 0,
    bound: float = 0.55,
) -> RandomCodes:
    """Count the random codes of which marching cubes makes no mesh.

    A code with nodes of either sign among a sparse part of the grid's nodes has a surface; the rest are meshed.
    """
    codes = draw_codes(prior, count, within, seed)
    left = np.ones(count, bool)
    for stride in _STRIDES:
        if not left.any():
            break
        left[left] = ~_crossed(prior, codes[left], resolution, stride, bound)
    failed = sum(not _has_mesh(prior, code, resolution, bound) for code in codes[left])
    return RandomCodes(count, failed, within, resolution, seed)


def _crossed(
    prior: ShapePrior, codes: Float[np.ndarray, "n l"], resolution: int, stride: int, bound: float
) -> Bool[np.ndarray, "n"]:
    """Whether some of every `stride`-th inner nodes of a grid are inside and some outside."""
    cells = 8 * -(-resolution // 8)  # as `extract_mesh` rounds them
    axis = np.linspace(-bound, bound, cells + 1)[stride:-1:stride]
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    like = prior.decoder.like
    points = torch.as_tensor(nodes, dtype=like.dtype, device=like.device)
    found = []
    for part in torch.as_tensor(codes, dtype=like.dtype, device=like.device).split(_TOGETHER):
        owner = torch.arange(len(part), device=like.device).repeat_interleave(len(points))
        with torch.no_grad():
            value = prior.decoder(points.repeat(len(part), 1), part, owner).reshape(len(part), -1)
        sane = value.isfinite().all(dim=1)
        found.append(sane & (value < 0).any(dim=1) & (value > 0).any(dim=1))
    return torch.cat(found).cpu().numpy() if found else np.empty(0, bool)


def _has_mesh(prior: ShapePrior, code: Float[np.ndarray, "l"], resolution: int, bound: float) -> bool:
    try:
        return len(extract_mesh(prior.decoder, code, resolution, bound).faces) > 0
    except SolveError:
        return False
