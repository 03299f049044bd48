"""The prior of a category of which no shapes were learnt: a superquadric of any size and any extents."""

from dataclasses import asdict

import numpy as np
import torch

from factors.superquadric import Superquadric
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import digest

NAME = "superquadric"
"""What maps call the prior of an object that has none of its own."""

_CODE_SIGMA = (1.5, 1.5, 0.7)
_STARTS = ((-2.0, 1.5, 0.0), (-2.0, -2.0, 0.0))
"""Beside the mean, a rounded box: an upright cylinder and an ellipsoid."""

_SIZE_MEAN, _SIZE_LOG_SIGMA = 0.9, 0.6
"""Diagonals from 0.3 m (a bin) to 3 m (a wardrobe) within two deviations."""

_ANISOTROPY_SIGMA = 0.5
"""Each extent is within a factor of e of their mean: shelves are flat and lamps are tall."""

_RESIDUAL_SIGMA = 0.04
"""Real objects have handles, legs and hollows: their surfaces lie that far from a superquadric's, in diagonals."""


def fallback_prior(category: str) -> ShapePrior:
    """A superquadric for objects of `category`: what it is shaped like is known to a few per cent of its diagonal."""
    decoder = Superquadric()
    mean, covariance = np.zeros(3), np.diag(np.square(_CODE_SIGMA))
    tensors = {"code_mean": torch.from_numpy(mean), "code_covariance": torch.from_numpy(covariance)}
    return ShapePrior(
        category=category,
        decoder=decoder.eval(),
        code_mean=mean,
        code_covariance=covariance,
        residual_sigma=_RESIDUAL_SIGMA,
        size_mean=_SIZE_MEAN,
        size_log_sigma=_SIZE_LOG_SIGMA,
        anisotropy_sigma=_ANISOTROPY_SIGMA,
        card={
            "fallback": NAME,
            "decoder": asdict(decoder.config),
            "sha256": digest(tensors),
            "residual_source": "a guess, not measured",
            "size_source": "a wide guess",
        },
        prototypes=np.array(_STARTS),
    )
