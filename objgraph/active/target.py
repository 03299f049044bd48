"""An object as a map knows it, ready to be asked what a view of it would tell."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from factors import checks
from factors.state import RIGID_DOF, ObjectState
from objgraph.active.headings import OtherHeading, other_headings
from objgraph.active.surface_sample import SurfaceSample, sample_surface
from objgraph.covariance.heading_modes import HeadingModes
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.surface import metric_sdf_jacobian
from objgraph.errors import ActiveVisionError, SolveError
from objgraph.estimate.heading_modes import HeadingModesConfig
from objgraph.priors.mesh import RESOLUTION, RESOLUTIONS
from objgraph.priors.shape_prior import ShapePrior


@dataclass(frozen=True, eq=False)
class Target(SurfaceSample):
    """An estimate, and its surface linearised once: candidates differ only in which of its points they see."""

    name: str
    state: ObjectState
    stands: bool
    """Whether its lower side is where the floor is, and so as good as seen."""
    information: Float[np.ndarray, "d d"]
    """Inverse covariance of pose, log-scale and code."""
    jacobian: Float[np.ndarray, "m d"]
    """Of the metric SDF at the points."""
    corner_jacobian: Float[np.ndarray, "24 9"]
    """Of the corners of its box, world frame, w.r.t. pose and log-scale."""
    surface_misfit: float = 1.0
    """Factor on the variances of the surface (`ShapePrior.surface_misfit`)."""
    seen_from: tuple[gtsam.Pose3, ...] = ()
    """T_world_camera of the views that the estimate is made from; none says that nothing of it was seen yet."""
    probability: float = 1.0
    """That it stands as it was found."""
    others: tuple[OtherHeading, ...] = ()
    """How else it may stand."""
    temperature: float = HeadingModesConfig.temperature
    """So much cost between two headings is believed as one nat, as the estimate believed it."""

    @property
    def surface_sigma(self) -> Float[np.ndarray, "m"]:
        """Standard deviation of the surface along its normal at the points, metres."""
        covariance = self.surface_misfit * np.linalg.inv(self.information)
        return np.sqrt(np.einsum("mi,ij,mj->m", self.jacobian, covariance, self.jacobian, optimize=True))

    @property
    def centre(self) -> Float[np.ndarray, "3"]:
        """Of its box along the world's axes."""
        return (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2


def target(
    name: str,
    prior: ShapePrior,
    state: ObjectState,
    covariance: ObjectCovariance,
    *,
    seen_from: Sequence[gtsam.Pose3] = (),
    turns: HeadingModes | None = None,
    points: int = 600,
    resolution: int = RESOLUTION,
    seed: int = 0,
) -> Target:
    """What an estimate that was made from some views says of its surface, at that many points.

    `turns` with their states are the other headings that it may have.

    Raises:
        ActiveVisionError: the covariance is not of this state, or not positive definite.
        SolveError: the code has no surface.
    """
    checks.text("the name of a target", name, ActiveVisionError)
    checks.instance(f"{name}: prior", prior, ShapePrior, ActiveVisionError)
    checks.instance(f"{name}: state", state, ObjectState, ActiveVisionError)
    checks.instance(f"{name}: covariance", covariance, ObjectCovariance, ActiveVisionError)
    checks.whole(f"{name}: points", points, checks.Range(1, 10**6), ActiveVisionError)
    checks.whole(f"{name}: resolution", resolution, RESOLUTIONS, ActiveVisionError)
    checks.whole(f"{name}: seed", seed, error=ActiveVisionError)
    seen_from = checks.tuple_of(f"{name}: seen_from", seen_from, gtsam.Pose3, ActiveVisionError)
    if turns is not None:
        checks.instance(f"{name}: turns", turns, HeadingModes, ActiveVisionError)
    d = RIGID_DOF + len(state.code)
    if covariance.matrix.shape != (d, d):
        raise ActiveVisionError(
            f"{name}: its covariance is over {len(covariance.axes)} axes, its state has {d}"
        )
    try:
        root = np.linalg.inv(np.linalg.cholesky(covariance.matrix))
    except np.linalg.LinAlgError as error:
        raise ActiveVisionError(f"{name}: its covariance is not positive definite") from error
    try:
        surface = sample_surface(prior, state, points, resolution, seed)
    except SolveError as error:
        raise SolveError(f"{name}: {error}") from error
    corners = _corners(prior, state, surface)
    others = () if turns is None else other_headings(prior, state, surface, turns, corners, resolution, seed)
    return Target(
        **vars(surface),
        name=name,
        state=state,
        stands=prior.feet is not None,
        information=root.T @ root,
        jacobian=metric_sdf_jacobian(prior.decoder, state, surface.points)[1].numpy(),
        corner_jacobian=_corner_jacobian(state, corners),
        surface_misfit=prior.surface_misfit,
        seen_from=seen_from,
        probability=1.0 if turns is None else float(turns.probability[0]),
        others=others,
        temperature=HeadingModesConfig.temperature if prior.guess is None else prior.guess.config.temperature,
    )


def _corners(prior: ShapePrior, state: ObjectState, surface: SurfaceSample) -> Float[np.ndarray, "8 3"]:
    """Of the prior's box or, where it has none, of the one about the object's own surface; canonical."""
    if prior.box is not None:
        low, high = -prior.box / 2, prior.box / 2
    else:
        p_object = state.to_object(surface.vertices)
        low, high = p_object.min(axis=0), p_object.max(axis=0)
    return np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1).reshape(8, 3)


def _corner_jacobian(state: ObjectState, p_object: Float[np.ndarray, "8 3"]) -> Float[np.ndarray, "24 9"]:
    """R [-[s p]x, I, diag(s p)], corner by corner: GTSAM's Pose3 tangent in the body frame, then the log-scale."""
    R = state.T_world_object.rotation().matrix()
    metric = p_object * state.scale
    rows = [np.concatenate([-gtsam.SO3.Hat(p), np.eye(3), np.diag(p)], axis=1) for p in metric]
    return np.concatenate([R @ row for row in rows])
