"""The factors of one object: what is known of it beforehand, and what each view says."""

from dataclasses import dataclass, field
from typing import Literal

import gtsam
import numpy as np
from jaxtyping import Float

from factors.base import ObservationFactor
from factors.depth import DepthFactor, RaySampling
from factors.filled_box import FilledBoxFactor
from factors.floor import SPACING, FloorFactor, floor_share
from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
from factors.priors import code_prior, placed_prior, scale_prior, sized_prior, upright_prior
from factors.rays import Rays
from factors.rendering import Renderer
from factors.state import ObjectKeys
from factors.surface import SurfaceFactor
from factors.weighting import Weighting
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior

RENDERERS: dict[str, Renderer] = {
    "full": FullDistribution(),
    "probabilistic": Probabilistic(),
    "sampled": Sampled(),
    "deterministic": Deterministic(),
}


@dataclass(frozen=True)
class GraphConfig:
    """How measurements and priors are weighed."""

    renderer: Literal["full", "probabilistic", "sampled", "deterministic"] = "full"
    """The 2D factor's renderer: the full termination distribution, or a Gaussian depth, the paper's, NodeSLAM's or
    DSP-SLAM's."""
    sampling: RaySampling = field(default_factory=RaySampling)
    evidence: float = 1.0
    """Independent measurements a patch of seen surface counts for, in each of the two factors of a view."""
    anisotropy_sigma: float = 0.1
    """Standard deviation of each axis' log-scale about their mean: the code, not the scale, stretches shapes."""
    code_spread: float = 3.0
    """Factor on the code prior's standard deviations: a Gaussian through several kinds of shapes is dense between
    them, at shapes of no kind (a table without legs), and would hold codes there."""
    upright_sigma: float = 0.03
    """Radians by which an object that stands on the floor may lean, about each level axis."""
    floor_sigma: float = 0.01
    """Metres to which the floor's height is known."""
    floor_spacing: float = SPACING
    """Metres between the rays that find out what goes on under the floor."""
    sides: float | None = 2.0
    """How well shapes touch the sides of the box that all of the prior's fill, in standard deviations of its decoder;
    None where they need not."""
    tight_box: bool = False
    """Whether rays are cut within the box that the prior's shapes fill, and not within a cube that holds any shape."""


@dataclass(frozen=True)
class DetectedBox:
    """A detector's box about an object, as a measurement of its place and size."""

    T_world_object: gtsam.Pose3
    """Its middle, and axes as the priors have them: y up, front at -z."""
    size: Float[np.ndarray, "3"]
    """Edges along the object's axes, metres."""
    position_sigma: float
    """Metres, along each axis."""
    heading_sigma: float
    """Radians."""
    size_sigma: float
    """Of the logarithm of each edge."""

    def log_scale(self, prior: ShapePrior) -> Float[np.ndarray, "3"]:
        """At which the shapes of a prior fill the box."""
        return np.log(self.size / prior.start_extents[0])


_DETECTORS_LEAN = 0.3
"""Radians: a detector's boxes are level, which says next to nothing of how its object leans."""


def detection_priors(prior: ShapePrior, keys: ObjectKeys, box: DetectedBox) -> list[gtsam.NonlinearFactor]:
    """What a detector says of an object's place and size."""
    return [
        placed_prior(keys, box.T_world_object, box.heading_sigma, _DETECTORS_LEAN, box.position_sigma),
        sized_prior(keys, box.log_scale(prior), box.size_sigma),
    ]


def state_priors(
    prior: ShapePrior, keys: ObjectKeys, config: GraphConfig, up_world: Float[np.ndarray, "3"] | None
) -> list[gtsam.NonlinearFactor]:
    """Priors on the object's code, on its scale and, with `up_world`, on its lean."""
    anisotropy = prior.anisotropy_sigma or config.anisotropy_sigma
    factors = [
        code_prior(keys, prior.code_mean, config.code_spread**2 * prior.code_covariance),
        scale_prior(keys, np.log(prior.size_mean), prior.size_log_sigma, anisotropy),
    ]
    if up_world is not None:
        factors.append(upright_prior(keys, up_world, config.upright_sigma))
    return factors


def view_factors(
    prior: ShapePrior, keys: ObjectKeys, view: ObjectView, camera: gtsam.Pose3 | int, config: GraphConfig
) -> list[ObservationFactor]:
    """The 3D and the 2D factor of one view; `camera` is T_world_camera or the key of a `Pose3` that holds it."""
    surface = SurfaceFactor(
        keys, prior.decoder, camera, view.points_camera, view.points_sigma,
        prior_sigma=prior.residual_sigma, weighting=_weighting(view.points_share, config),
    )  # fmt: skip
    return [surface, ray_factor(prior, keys, camera, view.rays, view.rays_share, config)]


def floor_factor(
    prior: ShapePrior, keys: ObjectKeys, up_world: Float[np.ndarray, "3"], floor: float, config: GraphConfig
) -> FloorFactor:
    """Nothing of the object lies below the floor, whose height along `up_world` is `floor`, and what has feet stands."""
    return FloorFactor(
        keys, prior.decoder, up_world, floor, sigma=config.floor_sigma, spacing=config.floor_spacing, stands=prior.feet, renderer=RENDERERS[config.renderer],
        prior_sigma=prior.residual_sigma, weighting=_weighting(floor_share(config.floor_spacing), config),
        half_box=prior.half_box(config.tight_box),
    )  # fmt: skip


def box_factor(prior: ShapePrior, keys: ObjectKeys, config: GraphConfig) -> list[FilledBoxFactor]:
    """The object's shape is as large as the box that all of the prior's fill; nothing where they have none."""
    if prior.box is None or config.sides is None:
        return []
    return [FilledBoxFactor(keys, prior.decoder, prior.box, config.sides * prior.residual_sigma)]


def ray_factor(
    prior: ShapePrior,
    keys: ObjectKeys,
    camera: gtsam.Pose3 | int,
    rays: Rays,
    share: Float[np.ndarray, "r"],
    config: GraphConfig,
) -> DepthFactor:
    """A 2D factor alone; `share` is the part of an independent measurement that each ray is."""
    return DepthFactor(
        keys, prior.decoder, camera, rays,
        renderer=RENDERERS[config.renderer], prior_sigma=prior.residual_sigma,
        sampling=config.sampling, weighting=_weighting(share, config), half_box=prior.half_box(config.tight_box),
    )  # fmt: skip


def _weighting(share: float | Float[np.ndarray, "n"], config: GraphConfig) -> Weighting:
    return Weighting("information", np.minimum(1.0, config.evidence * np.asarray(share)))
