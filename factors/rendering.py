"""What a depth renderer offers: scores of rays from the SDF along them, for either estimator."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from factors.rays import RayCells

ESCAPE = 1.1
"""A ray that escapes is given this multiple of the depth at which it leaves the object's box."""


CLEAR = 1.0
"""Signed distance, metres, that stands for free space wherever nothing is decoded."""


@dataclass(frozen=True)
class RayTargets:
    """Observations of r rays as tensors; the meaning of the fields is that of `factors.rays.Rays`."""

    depth: Float[Tensor, "r"]
    hit: Bool[Tensor, "r"]
    end: Float[Tensor, "r"]
    sigma: Float[Tensor, "r"]

    @property
    def stop(self) -> Float[Tensor, "r"]:
        """Depth of a hit; infinite where the ray passes the object."""
        return torch.where(self.hit, self.depth, torch.inf)


class RenderedRows(NamedTuple):
    """Scores of r rays in metres, and q residual rows each with their derivative w.r.t. the k samples' SDF."""

    loss: Float[Tensor, "r"]
    residual: Float[Tensor, "r q"]
    d_sdf: Float[Tensor, "r q k"]


@dataclass(frozen=True)
class RaySamples:
    """What a renderer is given of r rays with k samples each."""

    sdf: Float[Tensor, "r k"]
    """Mean of the signed distance at every sample, metres."""
    sdf_sigma: Float[Tensor, "r k"]
    """Its standard deviation, metres."""
    cells: RayCells
    targets: RayTargets
    slope: float
    """Of the occupancy's sigmoid, 1/metres."""

    @property
    def escape(self) -> Float[Tensor, "r"]:
        """The depth that an escaping ray is given: beyond the box and, where it should have ended, beyond that depth."""
        far = self.cells.far
        return ESCAPE * torch.where(self.targets.hit, torch.maximum(far, self.targets.depth), far)


class Renderer(Protocol):
    """Scores rays from the metric SDF at their samples.

    The graph asks for `freeze` and then for `render` with what it returned as `spread`; an estimator that follows
    gradients asks for `score`.
    """

    def freeze(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """Standard deviation of each ray's depth, metres, to be held while a quadratic is minimised."""
        ...

    def render(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> RenderedRows: ...

    def loss(self, samples: RaySamples, spread: Float[Tensor, "r"]) -> Float[Tensor, "r"]:
        """The loss of `render` alone."""
        ...

    def score(self, samples: RaySamples) -> Float[Tensor, "r"]:
        """Score of each ray, metres; autograd knows its derivatives w.r.t. both the SDF and its deviation."""
        ...
