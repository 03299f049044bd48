"""DSP-SLAM's Gauss-Newton on squared distances and depth errors, or Huber's of them, with three scales instead of one.

Wang, Runz, Agapito, "DSP-SLAM: Object Oriented SLAM with Deep Shape Priors", 3DV 2021, section 4.3; weights and
iterations as given there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float

from factors import checks
from factors.gaussian_depth import Deterministic
from factors.rendering import RaySamples
from factors.state import POSE_DOF, RIGID_DOF, ObjectState
from objgraph.errors import ConfigError, SolveError
from objgraph.estimate.pool import Pool
from objgraph.estimate.task import Estimate, EstimationTask, unusable
from objgraph.estimate.terms import DrawnRays, RaySteps, draw_rays, linearize


@dataclass(frozen=True)
class GaussNewtonConfig:
    """Weights of the squared terms."""

    iterations: int = 20
    points: int = 1000
    rays: int = 1000
    steps: RaySteps = field(default_factory=RaySteps)
    surface_weight: float = 100.0
    """Of the mean squared distance."""
    render_weight: float = 2.5
    """Of the mean squared depth error."""
    code_weight: float = 0.25
    """Of the code's squared norm, about the prior's mean."""
    damping: float = 0.0
    """Added to the diagonal of the normal equations (Levenberg's), in every step the same."""
    huber: float | None = None
    """Metres of distance or depth beyond which an error counts linearly; None counts all squared."""
    one_scale: bool = False
    """Whether the three scales grow together, by one unknown (7 degrees of freedom), and keep the start's ratios."""
    one_view: bool = False
    """Whether rays are drawn of the first view alone; surface points are of all."""
    seed: int = 0
    """Of the points and rays drawn."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, iterations=checks.Range(1), points=checks.Range(1), rays=checks.Range(1)
        )


@dataclass(frozen=True)
class GaussNewtonEstimator:
    """Full steps, a fixed number of them; gives no covariance."""

    config: GaussNewtonConfig = field(default_factory=GaussNewtonConfig)

    def estimate(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None = None
    ) -> list[Estimate | SolveError]:
        """See `Estimator`; the first start of every task is used."""
        results = []
        for i, task in enumerate(tasks):
            results.append(unusable(task) or self._one(task))
            if progress is not None:
                progress(i + 1, len(tasks))
        return results

    def _one(self, task: EstimationTask) -> Estimate | SolveError:
        config = self.config
        pool = Pool.of(task.views, task.prior.half_box(config.steps.tight_box))
        if config.one_view:
            pool = replace(pool, rays=pool.rays.take(pool.rays.first_view))
        drawn = pool.draw(np.random.default_rng(config.seed), config.points, config.rays)
        if not len(drawn.p_world):
            return SolveError(f"{task.name}: no view has a surface point")
        state, costs = task.starts[0], []
        for i in range(config.iterations + 1):
            (rays,) = draw_rays(task.prior.decoder, [state], [drawn], config.steps)
            cost, H, gradient = self._normal_equations(task, state, drawn, rays)
            if not np.isfinite(cost):
                return SolveError(f"{task.name}: the cost after {i} steps is {cost}")
            costs.append(cost)
            if i == config.iterations:
                break
            step = self._step(H, gradient)
            if not np.isfinite(step).all():
                return SolveError(f"{task.name}: the normal equations have no solution")
            state = state.retract(step)
        return Estimate(state, None, costs[0], costs[-1], config.iterations + 1, 0)

    def _step(self, H: Float[np.ndarray, "d d"], gradient: Float[np.ndarray, "d"]) -> Float[np.ndarray, "d"]:
        """The damped solution along what may move; NaN where there is none."""
        along = np.eye(len(H))
        if self.config.one_scale:
            along[POSE_DOF:RIGID_DOF, POSE_DOF] = 1.0
            along = np.delete(along, np.arange(POSE_DOF + 1, RIGID_DOF), axis=1)
        damped = along.T @ H @ along + self.config.damping * np.eye(along.shape[1])
        try:
            return along @ np.linalg.solve(damped, -along.T @ gradient)
        except np.linalg.LinAlgError:
            return np.full(len(H), np.nan)

    def _normal_equations(
        self, task: EstimationTask, state: ObjectState, drawn: Pool, rays: DrawnRays
    ) -> tuple[float, Float[np.ndarray, "d d"], Float[np.ndarray, "d"]]:
        """Half the weighted sum of squares or of Huber's losses, its Gauss-Newton matrix and its gradient."""
        config, n = self.config, len(drawn.p_world)
        (found,) = linearize(task.prior.decoder, [state], [np.concatenate([drawn.p_world, rays.p_near])])
        sdf = rays.sdf.masked_scatter(rays.near, found.sdf[n:])
        renderer = Deterministic()
        error, counts, d_sdf = renderer.depth_error(
            RaySamples(sdf, torch.zeros_like(sdf), rays.cells, rays.targets, config.steps.slope)
        )
        jacobian = sdf.new_zeros(*sdf.shape, found.jacobian.shape[1])
        jacobian[rays.near] = found.jacobian[n:]
        J_depth = (counts[:, None] * (d_sdf[:, None, :] @ jacobian)[:, 0]).cpu().double().numpy()
        e_depth = (counts * error).cpu().double().numpy()
        J, e = found.jacobian[:n].cpu().double().numpy(), found.sdf[:n].cpu().double().numpy()
        w, w_depth = config.surface_weight / n, config.render_weight / rays.count
        h, h_depth = huber_weight(e, config.huber), huber_weight(e_depth, config.huber)
        H = w * J.T @ (h[:, None] * J) + w_depth * J_depth.T @ (h_depth[:, None] * J_depth)
        gradient = w * J.T @ (h * e) + w_depth * J_depth.T @ (h_depth * e_depth)
        offset = state.code - task.prior.code_mean
        H[RIGID_DOF:, RIGID_DOF:] += config.code_weight * np.eye(len(offset))
        gradient[RIGID_DOF:] += config.code_weight * offset
        # h (2 - h) e^2 is twice Huber's loss
        squares = w * e @ (h * (2 - h) * e) + w_depth * e_depth @ (h_depth * (2 - h_depth) * e_depth)
        squares += config.code_weight * offset @ offset
        return 0.5 * float(squares), H, gradient


def huber_weight(error: Float[np.ndarray, "n"], beyond: float | None) -> Float[np.ndarray, "n"]:
    """w with w e the derivative of Huber's loss, which is linear beyond a threshold; one where there is none."""
    if beyond is None:
        return np.ones_like(error)
    return beyond / np.maximum(np.abs(error), beyond)
