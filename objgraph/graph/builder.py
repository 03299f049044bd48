"""The one place where an object's factors are put together: what is known of it beforehand, and what each view says."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from jaxtyping import Float

from factors import checks
from factors.base import ObservationFactor
from factors.checks import DEVIATIONS, PLACES
from factors.depth import DepthFactor, RaySampling
from factors.errors import FactorError
from factors.filled_box import FilledBoxFactor
from factors.floor import SPACING, SPACINGS, FloorFactor
from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
from factors.keys import readable_key
from factors.priors import placed_prior, sized_prior, upright_prior
from factors.rays import Rays
from factors.rendering import Renderer
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from objgraph.errors import ConfigError, ObservationError
from objgraph.graph.single_object import ALONE, SingleObject
from objgraph.observation.sampling import ObjectView
from objgraph.priors.shape_prior import ShapePrior

RENDERERS: dict[str, Renderer] = {
    "full": FullDistribution(),
    "probabilistic": Probabilistic(),
    "sampled": Sampled(),
    "deterministic": Deterministic(),
}
_LEANS_DEG = 65.0
"""Lean of a start from which on it is taken for one in another frame."""


@dataclass(frozen=True)
class GraphConfig:
    """How measurements and priors are weighed."""

    renderer: Literal["full", "probabilistic", "sampled", "deterministic"] = "full"
    """The 2D factor's renderer: the full termination distribution, or a Gaussian depth, the paper's, NodeSLAM's or
    DSP-SLAM's."""
    sampling: RaySampling = field(default_factory=RaySampling)
    surface_tail: float | None = 0.05
    """Metres off the surface from which on a point counts as something else's that the mask holds; None where masks hold nothing
    else."""
    anisotropy_sigma: float = 0.1
    """Standard deviation of each axis' log-scale about their mean: the code, not the scale, stretches shapes."""
    pose_sigma: tuple[float, float] | None = None
    """Radians and metres by which each view's camera pose may be wrong, about and along each of its axes; None takes poses as
    exact. For one object in a graph of its own: where cameras are variables of a graph, that graph says it."""
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

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind, or there is no such renderer."""
        checks.settings(
            self, ConfigError, surface_tail=DEVIATIONS, anisotropy_sigma=DEVIATIONS, pose_sigma=DEVIATIONS,
            upright_sigma=DEVIATIONS, floor_sigma=DEVIATIONS, floor_spacing=SPACINGS, sides=DEVIATIONS,
        )  # fmt: skip


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

    def __post_init__(self) -> None:
        """Raises ObservationError where it is no box, or a standard deviation is not positive."""
        checks.pose("a detected box's T_world_object", self.T_world_object, ObservationError)
        size = checks.reals("a detected box's size", self.size, (3,), DEVIATIONS, ObservationError)
        object.__setattr__(self, "size", size)
        for name in ("position_sigma", "heading_sigma", "size_sigma"):
            checks.number(f"a detected box's {name}", getattr(self, name), DEVIATIONS, ObservationError)

    def log_scale(self, prior: ShapePrior) -> Float[np.ndarray, "3"]:
        """At which the shapes of a prior fill the box."""
        return np.log(self.size / prior.start_extents[0])


_DETECTORS_LEAN = 0.3
"""Radians: a detector's boxes are level, which says next to nothing of how its object leans."""


@dataclass(frozen=True, eq=False)
class ObjectBuilder:
    """Makes the factors of objects in one scene, for whichever graph they go into."""

    config: GraphConfig = field(default_factory=GraphConfig)
    up_world: Float[np.ndarray, "3"] | None = None
    """Unit vector against gravity, where it is known."""
    floor: float | None = None
    """The floor's height along `up_world`, metres, where it is known."""

    def __post_init__(self) -> None:
        """Raises ConfigError or ObservationError where one of them is none."""
        checks.instance("config", self.config, GraphConfig, ConfigError)
        if self.up_world is not None:
            up = checks.direction("up_world", self.up_world, ObservationError)
            object.__setattr__(self, "up_world", up)
        if self.floor is not None:
            checks.number("floor", self.floor, PLACES, ObservationError)

    def priors(
        self, prior: ShapePrior, keys: ObjectKeys, box: DetectedBox | None = None
    ) -> list[gtsam.NonlinearFactor]:
        """What is known of code and scale, of the lean where up is known, and what a detector's box says."""
        factors = [prior.code_factor(keys), prior.scale_factor(keys, self.config.anisotropy_sigma)]
        if self.up_world is not None:
            factors.append(self.upright(keys))
        if box is not None:
            checks.instance("box", box, DetectedBox, ObservationError)
            factors += [
                placed_prior(
                    keys, box.T_world_object, box.heading_sigma, _DETECTORS_LEAN, box.position_sigma
                ),
                sized_prior(keys, box.log_scale(prior), box.size_sigma),
            ]
        return factors

    def check_upright(self, keys: ObjectKeys, state: ObjectState) -> None:
        """Raise FactorError where up is known and the object leans so much that it must be in another frame."""
        if self.up_world is None:
            return
        cosine = state.T_world_object.rotation().matrix()[:, 1] @ self.up_world
        if (lean := np.degrees(np.arccos(np.clip(cosine, -1, 1)))) > _LEANS_DEG:
            raise FactorError(
                f"{readable_key(keys.pose)}: the object's y axis, which is up, leans {lean:.0f} degrees from up_world: "
                "turn the start about, or leave out up_world"
            )

    def upright(self, keys: ObjectKeys) -> gtsam.NonlinearFactor:
        """The object does not lean. Up must be known."""
        assert self.up_world is not None
        return upright_prior(keys, self.up_world, self.config.upright_sigma)

    def view(
        self,
        prior: ShapePrior,
        keys: ObjectKeys,
        view: ObjectView,
        camera: gtsam.Pose3 | int,
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> list[ObservationFactor]:
        """The 3D and the 2D factor of one view.

        `camera` is T_world_camera or the key of a `Pose3` that holds it; with `body_T_camera` that of the body.
        """
        return self._factors(
            prior, keys, camera, (view.points_camera, view.points_sigma, view.points_share),
            (view.rays, view.rays_share), body_T_camera,
        )  # fmt: skip

    def views(
        self, prior: ShapePrior, keys: ObjectKeys, views: Sequence[ObjectView]
    ) -> list[ObservationFactor]:
        """The same of several views from known cameras, in one 3D and one 2D factor, whose camera frame is the world's."""
        if not views:
            return []
        points = zip(*((v.points_world, v.points_sigma, v.points_share) for v in views), strict=True)
        rays = Rays.together([view.rays.in_world(view.T_world_camera) for view in views])
        shares = np.concatenate([view.rays_share for view in views])
        p_world, sigma, share = map(np.concatenate, points)
        return self._factors(prior, keys, gtsam.Pose3(), (p_world, sigma, share), (rays, shares))

    def _factors(
        self,
        prior: ShapePrior,
        keys: ObjectKeys,
        camera: gtsam.Pose3 | int,
        points: tuple[np.ndarray, np.ndarray, np.ndarray],
        rays: tuple[Rays, np.ndarray],
        body_T_camera: gtsam.Pose3 | None = None,
    ) -> list[ObservationFactor]:
        p_camera, sigma, share = points
        surface = SurfaceFactor(
            keys, prior.decoder, camera, p_camera, sigma, prior_sigma=prior.residual_sigma, share=share,
            tail=self.config.surface_tail, body_T_camera=body_T_camera,
        )  # fmt: skip
        depth = DepthFactor(
            keys, prior.decoder, camera, rays[0],
            renderer=RENDERERS[self.config.renderer], prior_sigma=prior.residual_sigma,
            sampling=self.config.sampling, share=rays[1],
            half_box=prior.half_box(self.config.tight_box), body_T_camera=body_T_camera,
        )  # fmt: skip
        return [surface, depth]

    def box(self, prior: ShapePrior, keys: ObjectKeys) -> list[FilledBoxFactor]:
        """The object's shape is as large as the box that all of the prior's fill; nothing where they have none."""
        if prior.box is None or self.config.sides is None:
            return []
        return [FilledBoxFactor(keys, prior.decoder, prior.box, self.config.sides * prior.residual_sigma)]

    def standing(self, prior: ShapePrior, keys: ObjectKeys) -> list[FloorFactor]:
        """Nothing of the object lies below the floor, and what has feet stands on it; nothing where the floor is unknown."""
        if self.floor is None or self.up_world is None:
            return []
        config = self.config
        return [
            FloorFactor(
                keys, prior.decoder, self.up_world, self.floor,
                sigma=config.floor_sigma, spacing=config.floor_spacing, stands=prior.feet, prior_sigma=prior.residual_sigma,
                half_box=prior.half_box(config.tight_box),
            )
        ]  # fmt: skip

    def alone(
        self,
        prior: ShapePrior,
        state: ObjectState,
        views: Sequence[ObjectView],
        box: DetectedBox | None = None,
    ) -> SingleObject:
        """One object at `state` in a graph of its own, its views, and a detector's box.

        Cameras are where the views have them or, with a `pose_sigma`, variables X(0), X(1), ... that are known so well.

        Raises:
            FactorError: the state or a view cannot be used.
        """
        self.check_upright(ALONE, state)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        state.insert(values, ALONE)
        for factor in self.priors(prior, ALONE, box):
            graph.push_back(factor)
        factors: list[ObservationFactor] = []
        if self.config.pose_sigma is None:
            factors += self.views(prior, ALONE, views)
        else:
            for k, view in enumerate(views):
                values.insert(X(k), view.T_world_camera)
                graph.push_back(gtsam.PriorFactorPose3(X(k), view.T_world_camera, self._pose_noise()))
                factors += self.view(prior, ALONE, view, X(k))
        factors += [*self.box(prior, ALONE), *self.standing(prior, ALONE)]
        for factor in factors:
            graph.push_back(factor.gtsam_factor())
        return SingleObject(prior.category, graph, values, factors, start=values)

    def _pose_noise(self) -> gtsam.noiseModel.Base:
        assert self.config.pose_sigma is not None
        rotation, translation = self.config.pose_sigma
        return gtsam.noiseModel.Diagonal.Sigmas(np.repeat([rotation, translation], 3))
