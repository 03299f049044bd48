"""A category's shape prior: decoder, distribution of codes, and what its training measured."""

from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from factors.code_mixture import CodeMixture, mixture_prior
from factors.priors import code_prior, scale_prior
from factors.proportions import Proportions, proportions_prior
from factors.rays import BOX_HALF_SIZE
from factors.sdf_decoder import SdfDecoder
from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.priors.first_guess import FirstGuess
from objgraph.priors.mesh import extract_mesh

_LOOSE = 1.15
"""Times that a tight box is larger than the shapes': a decoder draws outside of it as well."""


@dataclass(frozen=True)
class ShapePrior:
    """What the back-end knows of a category before it sees an object.

    Canonical frame: y up, front at -z, bounding box centred (ShapeNetCore.v2's axes), its diagonal 1 or, with a
    `box`, its edges those of the box.
    """

    category: str
    decoder: SdfDecoder
    code_mean: Float[np.ndarray, "l"]
    """Of the training codes; where these are of kinds, the one nearest to it, which is a shape."""
    code_covariance: Float[np.ndarray, "l l"]
    """Of all codes that the prior holds for likely: that of the training codes, or wider (docs/reference/training.md)."""
    residual_sigma: float
    """Standard deviation of the decoder's SDF error near unseen surfaces, in canonical units."""
    size_mean: float
    """Typical diagonal of the object's bounding box, metres."""
    size_log_sigma: float
    """Standard deviation of the logarithm of that diagonal."""
    card: dict[str, Any] = field(default_factory=dict)
    """The model card: data, licences, frame, training settings, measured errors, hash."""
    prototypes: Float[np.ndarray, "k l"] | None = None
    """Codes of typical training shapes that differ: where a fit may start beside the mean."""
    anisotropy_sigma: float | None = None
    """Standard deviation of each axis' log-scale about their mean; None leaves it to the graph's settings."""
    box: Float[np.ndarray, "3"] | None = None
    """Edges of the box that every shape is stretched to in the decoder's frame (`BoxFrame`); None where the
    decoder takes coordinates of diagonal 1 as they are."""
    guess: FirstGuess | None = None
    """Says from the points seen how an object may stand; None where none was trained."""
    surface_misfit: float = 1.0
    """Factor on the variances that marginals give the surface of real objects; one where nothing was measured."""
    kinds: CodeMixture | None = None
    """The kinds of shapes there are; None where codes are of the one Gaussian that `code_mean` and `code_covariance` give."""
    proportions: Proportions | None = None
    """What a code says of the proportions, where all shapes fill a `box`; None where they are as `anisotropy_sigma` says."""

    @property
    def digest(self) -> str:
        """Of the weights, as the card says: no code is decoded, and no estimate judged, by what belongs to others."""
        return str(self.card.get("sha256", "unknown"))

    @property
    def is_fallback(self) -> bool:
        """Whether it only stands in for a category of which no shapes were learnt."""
        return "fallback" in self.card

    @property
    def stands(self) -> bool:
        """Whether such objects stand on the floor: the card says so of those that need not."""
        return bool(self.card.get("stands", True))

    @property
    def feet(self) -> float | None:
        """Canonical distance from an object's centre down to its feet; None where shapes have no common box, or such
        objects need not stand on the floor."""
        return float(self.box[1]) / 2 if self.box is not None and self.stands else None

    def half_box(self, tight: bool) -> float | Float[np.ndarray, "3"]:
        """Half the edges of the canonical box to look for an object's surface in: a cube that holds any shape or, where
        `tight` and all shapes fill one box, that one and some more."""
        return _LOOSE * self.box / 2 if tight and self.box is not None else BOX_HALF_SIZE

    def code_factor(self, keys: ObjectKeys) -> gtsam.NonlinearFactor:
        """What is known of an object's code beforehand."""
        if self.kinds is None:
            return code_prior(keys, self.code_mean, self.code_covariance)
        return mixture_prior(keys, self.kinds)

    def scale_factor(self, keys: ObjectKeys, anisotropy_sigma: float = 0.1) -> gtsam.NonlinearFactor:
        """What is known of an object's scales beforehand, given its code where the prior knows its shapes' proportions; otherwise
        each axis deviates by `anisotropy_sigma` from their mean where the prior does not say by how much."""
        if self.proportions is not None:
            return proportions_prior(keys, self.proportions, np.log(self.size_mean), self.size_log_sigma)
        sigma = self.anisotropy_sigma or anisotropy_sigma
        return scale_prior(keys, np.log(self.size_mean), self.size_log_sigma, sigma)

    def draw_codes(self, count: int, rng: Generator, within: float | None = None) -> Float[np.ndarray, "n l"]:
        """Random codes, none beyond `within` standard deviations along an axis of its Gaussian if that is given."""
        if self.kinds is not None:
            return self.kinds.draw(count, rng, within)
        whitened = rng.normal(size=(count, len(self.code_mean)))
        while within is not None and (beyond := np.abs(whitened) > within).any():
            whitened[beyond] = rng.normal(size=np.count_nonzero(beyond))
        variances, axes = np.linalg.eigh(np.asarray(self.code_covariance, float))
        return self.code_mean + whitened * np.sqrt(np.maximum(variances, 0.0)) @ axes.T

    @cached_property
    def starts(self) -> Float[np.ndarray, "k l"]:
        """The mean code, then the prototypes."""
        mean = np.asarray(self.code_mean, float)[None]
        return mean if self.prototypes is None else np.concatenate([mean, self.prototypes])

    @cached_property
    def start_extents(self) -> Float[np.ndarray, "k 3"]:
        """Canonical extents of the shapes of `starts`: the box's where all fill one, whatever a mesh of theirs lacks; NaN
        where a code has no surface."""
        if self.box is not None:
            return np.tile(np.asarray(self.box, float), (len(self.starts), 1))
        extents = np.full((len(self.starts), 3), np.nan)
        for i, code in enumerate(self.starts):
            with suppress(SolveError):
                extents[i] = extract_mesh(self.decoder, code, resolution=32).extents
        return extents
