"""A shape prior whose best codes are known: boxes about the origin, in closed form."""

import numpy as np
import torch

from factors.sdf_decoder import SdfDecoder
from objgraph.priors.shape_prior import ShapePrior

MEAN_HALF = np.array([0.28, 0.32, 0.26])


class BoxDecoder(SdfDecoder):
    """The exact distance to a box; the code moves each half extent by a tenth of its entry."""

    halves: torch.Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("halves", torch.tensor(MEAN_HALF, dtype=torch.float32))

    @property
    def code_length(self):
        return 3

    @property
    def like(self):
        return self.halves

    def _enter(self, codes):
        return {"0": codes}

    def _d_enter(self, codes):
        return {"0": torch.eye(codes.shape[1]).to(codes)[None]}

    def _network(self, points, injected):
        q = points.abs() - (self.halves + 0.1 * injected["0"])
        outside = (q.clamp_min(0).square().sum(dim=1) + 1e-12).sqrt()
        return outside + q.amax(dim=1).clamp_max(0)


def box_prior(**card) -> ShapePrior:
    return ShapePrior(
        category="chair",
        decoder=BoxDecoder(),
        code_mean=np.zeros(3),
        code_covariance=0.5 * np.eye(3),
        residual_sigma=0.008,
        size_mean=1.0,
        size_log_sigma=0.3,
        card={"sha256": "box", **card},
        prototypes=np.array([[1.0, 0, 0], [0, -1.0, 0.5]]),
    )


def code_of(extents: np.ndarray) -> np.ndarray:
    """The code of a box of these extents once its diagonal is 1."""
    return (extents / np.linalg.norm(extents) / 2 - MEAN_HALF) / 0.1
