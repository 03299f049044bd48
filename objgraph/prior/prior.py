"""A category's shape prior: decoder, distribution of codes, and what its training measured."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from factors.decoder import Decoder


@dataclass(frozen=True)
class ShapePrior:
    """What the back-end knows of a category before it sees an object.

    Canonical frame: y up, front at -z, bounding box centred, its diagonal 1 (ShapeNetCore.v2's axes).
    """

    category: str
    decoder: Decoder
    code_mean: Float[np.ndarray, "l"]
    code_covariance: Float[np.ndarray, "l l"]
    """Empirical covariance of the training codes."""
    residual_sigma: float
    """Standard deviation of the decoder's SDF error near unseen surfaces, in canonical units."""
    size_mean: float
    """Typical diagonal of the object's bounding box, metres."""
    size_log_sigma: float
    """Standard deviation of the logarithm of that diagonal."""
    card: dict[str, Any] = field(default_factory=dict)
    """The model card: data, licences, frame, training settings, measured errors, hash."""
