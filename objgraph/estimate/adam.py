"""The paper's estimator: means and a diagonal covariance, both by gradient descent (eq:optimization, eq:final_loss).

Where it departs from the paper: the pose is world-to-object there and object-to-world here, and moves along its own
tangent; distances are metres; the derivative of sigma_s w.r.t. the means (a second derivative of the decoder) is left
out, so one forward and one backward pass an iteration give everything.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from factors import checks
from factors.gaussian_depth import Probabilistic
from factors.rendering import RaySamples, Renderer
from factors.score import energy_score, energy_score_monte_carlo
from factors.sdf_decoder import SdfDecoder
from factors.state import POSE_DOF, RIGID_DOF, ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import ConfigError, ObjectGraphError, SolveError
from objgraph.estimate.pool import Pool
from objgraph.estimate.standing import Standing
from objgraph.estimate.task import Estimate, EstimationTask, unusable
from objgraph.estimate.terms import DrawnRays, Linearized, RaySteps, draw_rays, linearize

_LEAST_SIGMA = 1e-6
"""Metres; the energy score of a surer distance is its absolute value."""
_SCALE = slice(POSE_DOF, RIGID_DOF)
_GROUPS = (slice(0, POSE_DOF), _SCALE, slice(RIGID_DOF, None))
"""Axes whose gradient is clipped together."""


@dataclass(frozen=True)
class AdamConfig:
    """The paper's settings, and the released weights."""

    iterations: int = 200
    learning_rate: float = 0.005
    points: int = 1000
    """Surface points of all views together, an iteration."""
    rays: int = 1000
    """Rays of all views together, an iteration."""
    redraw: int = 5
    """Iterations that the same points and rays serve."""
    steps: RaySteps = field(default_factory=RaySteps)
    surface_weight: float = 100.0
    """lambda_s of eq:final_loss; 0 leaves the 3D term out, as NodeSLAM does."""
    render_weight: float = 50.0
    """lambda_r."""
    code_weight: float = 30.0
    """lambda_c, of the mean square of the code's entries about the prior's mean. The released 3000 is for codes of
    another decoder; of 3000, 300 and 30 this one served the shipped priors best (docs/guides/compare.md)."""
    uncertainty: bool = True
    """Whether the covariance is estimated and scored; without it the scores are absolute errors (DSP-SLAM)."""
    pose_variance: float = 1e-4
    """First variance of rotation, translation and log-scale."""
    code_variance: float = 1e-6
    """First variance of the code."""
    monte_carlo: int | None = None
    """Samples of the paper's estimate of the 3D energy score (1000 there); by default the closed form."""
    seed: int = 0
    """Of the points and rays drawn."""
    clip: float | None = None
    """Norm above which an object's gradient is shortened to it, in each of six groups by itself: pose, log-scale and
    code, and the log-variances of each of them; None leaves it as long as it is."""
    world_scale: bool = False
    """Whether the scale's three unknowns are along the world's axes. What they do to an object that is turned is a
    stretch along its own axes and a shear, which no `ObjectState` holds: of the stretch `diag(exp(s))` in the world the
    state takes the diagonal of `R^T diag(s) R`, R being its rotation. So the step of its own log-scale is
    `(R * R)^T s` (elementwise square), and SDF derivatives, variances and Adam's moments are those of s along that
    path; the covariance has the variances that s gives the own axes. Of an upright object the height is as without,
    and at 45 degrees about the up axis length and width can but grow together."""
    standing: bool = False
    """Whether the graph's upright prior and, where the floor is known, its floor factor are added, at the weight of
    their negative log-likelihoods. Linearised in every iteration; the floor's rays are chosen with the others."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some, variance = checks.Range(1, 10**6), checks.Range(1e-18, 1e6)
        checks.settings(
            self, ConfigError, iterations=some, points=some, rays=some, redraw=some, pose_variance=variance,
            code_variance=variance, monte_carlo=checks.Range(2, 10**6), clip=checks.POSITIVE,
        )  # fmt: skip


@dataclass(frozen=True)
class AdamEstimator:
    """All objects of one decoder descend together; each takes its last iterate, as in the paper.

    Settings and `renderer` make it the paper's method, its variants, DSP-SLAM* and Node-SLAM*.
    """

    config: AdamConfig = field(default_factory=AdamConfig)
    renderer: Renderer = field(default_factory=lambda: Probabilistic(moments="sobol"))

    def estimate(
        self, tasks: Sequence[EstimationTask], progress: Callable[[int, int], None] | None = None
    ) -> list[Estimate | SolveError]:
        """See `Estimator`; the first start of every task is used."""
        results: list[Estimate | SolveError | None] = [None] * len(tasks)
        groups: dict[int, list[int]] = {}
        for i, task in enumerate(tasks):
            results[i] = unusable(task)
            if results[i] is None:
                groups.setdefault(id(task.prior.decoder), []).append(i)
        total = len(groups) * self.config.iterations
        for g, indices in enumerate(groups.values()):

            def tell(done: int, g: int = g) -> None:
                if progress is not None:
                    progress(g * self.config.iterations + done, total)

            descent = _Descent([tasks[i] for i in indices], self.config, self.renderer)
            for i, result in zip(indices, descent.run(tell), strict=True):
                results[i] = result
        return [result for result in results if result is not None]


class _Descent:
    """Adam on the objects of one decoder; the pose moves along the tangent at where it is."""

    def __init__(self, tasks: Sequence[EstimationTask], config: AdamConfig, renderer: Renderer) -> None:
        self.tasks, self.config, self.renderer = tasks, config, renderer
        self.decoder: SdfDecoder = tasks[0].prior.decoder
        self.states: list[ObjectState] = [task.starts[0] for task in tasks]
        self.pools = [Pool.of(task.views, task.prior.half_box(config.steps.tight_box)) for task in tasks]
        self.standing = [Standing(task, config.steps.slope) for task in tasks] if config.standing else []
        self.rngs = [np.random.default_rng(config.seed) for _ in tasks]
        length = self.decoder.code_length
        variance = [config.pose_variance] * RIGID_DOF + [config.code_variance] * length
        like = self.decoder.like
        self.log_variance = torch.tensor(variance).log().repeat(len(tasks), 1).to(like).requires_grad_()
        self.delta = torch.zeros_like(self.log_variance).requires_grad_()
        self.code_mean = torch.stack(
            [torch.as_tensor(np.asarray(task.prior.code_mean, float)).to(like) for task in tasks]
        )
        self.failures: dict[int, str] = {}

    def run(self, progress: Callable[[int], None]) -> list[Estimate | SolveError]:
        optimizer = torch.optim.Adam([self.delta, self.log_variance], lr=self.config.learning_rate)
        judged = drawn = self._draw()
        rays = self._place(drawn)
        with torch.no_grad():
            first = self._losses(drawn, rays, 0)
        for i in range(self.config.iterations):
            if i > 0 and i % self.config.redraw == 0:
                drawn = self._draw()
                rays = self._place(drawn)
            self._gradients(drawn, rays, i)
            optimizer.step()
            self._move()
            progress(i + 1)
        # on the points and rays of the first, so that the two can be compared
        rays = self._place(judged)
        with torch.no_grad():
            last = self._losses(judged, rays, 0)
        return [self._result(i, float(first[i]), float(last[i])) for i in range(len(self.tasks))]

    def _draw(self) -> list[Pool]:
        config = self.config
        return [
            pool.draw(rng, config.points, config.rays)
            for pool, rng in zip(self.pools, self.rngs, strict=True)
        ]

    def _place(self, drawn: Sequence[Pool]) -> list[DrawnRays]:
        """Choose the rays' samples where the objects are, those of the floor as well."""
        for i, standing in enumerate(self.standing):
            if np.isfinite(self.states[i].matrix).all():  # a start that is not is found out by its loss
                standing.refresh(self.states[i])
        return draw_rays(self.decoder, self.states, drawn, self.config.steps)

    def _gradients(
        self, drawn: Sequence[Pool], rays: Sequence[DrawnRays], iteration: int
    ) -> Float[Tensor, "b"]:
        """Each object's loss; the derivatives of all are left with the two leaves."""
        self.delta.grad, self.log_variance.grad = None, None
        loss = self._losses(drawn, rays, iteration)
        loss.sum().backward()
        for i in (~torch.isfinite(loss)).nonzero()[:, 0].tolist():
            self.failures.setdefault(i, f"the loss is not finite after {iteration} iterations")
        for grad in (self.delta.grad, self.log_variance.grad):
            if grad is not None:
                grad.nan_to_num_(0.0, 0.0, 0.0)
                if self.config.clip is not None:
                    clip_groups(grad, self.config.clip)
        return loss.detach()

    def _losses(self, drawn: Sequence[Pool], rays: Sequence[DrawnRays], iteration: int) -> Float[Tensor, "b"]:
        points = [each.p_world for each in drawn]
        both = linearize(
            self.decoder,
            self.states,
            [np.concatenate([p, r.p_near]) for p, r in zip(points, rays, strict=True)],
        )
        for i, found in enumerate(both if self.config.world_scale else ()):
            along = torch.as_tensor(own_from_world_scale(self.states[i])).to(found.jacobian)
            found.jacobian[:, _SCALE] = found.jacobian[:, _SCALE] @ along
        losses = []
        for i, (found, p, ray) in enumerate(zip(both, points, rays, strict=True)):
            surface = Linearized(found.sdf[: len(p)], found.jacobian[: len(p)])
            near = Linearized(found.sdf[len(p) :], found.jacobian[len(p) :])
            losses.append(self._loss(i, surface, near, ray, iteration))
        return torch.stack(losses)

    def _loss(
        self, i: int, surface: Linearized, near: Linearized, rays: DrawnRays, iteration: int
    ) -> Float[Tensor, ""]:
        """eq:final_loss of one object, linear in how its state moves and exact in how its variances do."""
        config = self.config
        code = torch.as_tensor(np.array(self.states[i].code)).to(self.code_mean) + self.delta[i, RIGID_DOF:]
        loss = config.code_weight * (code - self.code_mean[i]).square().mean()
        if config.surface_weight > 0:
            mu, sigma = self._sdf(i, surface)
            loss = loss + config.surface_weight * self._surface_score(mu, sigma, iteration).mean()
        if config.render_weight > 0:
            mu, sigma = self._sdf(i, near)
            sdf = rays.sdf.masked_scatter(rays.near, mu)
            sdf_sigma = torch.zeros_like(sdf).masked_scatter(rays.near, sigma)
            samples = RaySamples(sdf, sdf_sigma, rays.cells, rays.targets, config.steps.slope)
            score = self.renderer.score(samples)
            loss = loss + config.render_weight * score.sum() / rays.count
        if config.standing and bool(loss.isfinite()):
            loss = loss + self._standing_error(i)
        return loss

    def _standing_error(self, i: int) -> Float[Tensor, ""]:
        """Of upright prior and floor factor, linear within the squares in how the state moves."""
        try:
            A, b = self.standing[i].linearize(self.states[i])
        except (ObjectGraphError, RuntimeError) as error:  # GTSAM's own are RuntimeErrors
            self.failures.setdefault(i, str(error))
            return self.delta.new_zeros(())
        if self.config.world_scale:
            A[:, _SCALE] = A[:, _SCALE] @ own_from_world_scale(self.states[i])
        A, b = (torch.as_tensor(array).to(self.delta) for array in (A, b))
        return 0.5 * (A @ self.delta[i] - b).square().sum()

    def _sdf(self, i: int, at: Linearized) -> tuple[Float[Tensor, "n"], Float[Tensor, "n"]]:
        """Mean and standard deviation of the SDF (eq:sdf_mean, eq:sdf_variance)."""
        mu = at.sdf + at.jacobian @ self.delta[i]
        if not self.config.uncertainty:
            return mu, torch.full_like(mu, _LEAST_SIGMA)
        variance = at.jacobian.square() @ self.log_variance[i].exp()
        return mu, variance.clamp_min(_LEAST_SIGMA**2).sqrt()

    def _surface_score(self, mu: Tensor, sigma: Tensor, iteration: int) -> Float[Tensor, "n"]:
        if self.config.monte_carlo is None:
            return energy_score(mu, sigma)
        return energy_score_monte_carlo(mu, sigma, self.config.monte_carlo, self.config.seed + iteration)

    def _move(self) -> None:
        """Take the step from the tangent into the states; Adam's moments stay with the axes."""
        with torch.no_grad():
            steps = self.delta.detach().cpu().double().numpy()
            for i, step in enumerate(steps):
                if i not in self.failures:
                    if self.config.world_scale:
                        step[_SCALE] = own_from_world_scale(self.states[i]) @ step[_SCALE]
                    self.states[i] = self.states[i].retract(step)
            self.delta.zero_()

    def _result(self, i: int, first: float, last: float) -> Estimate | SolveError:
        task = self.tasks[i]
        if i in self.failures:
            return SolveError(f"{task.name}: {self.failures[i]}")
        covariance = None
        if self.config.uncertainty:
            variance = self.log_variance[i].detach().exp().cpu().double().numpy()
            if self.config.world_scale:
                variance[_SCALE] = own_from_world_scale(self.states[i]) ** 2 @ variance[_SCALE]
            covariance = ObjectCovariance.diagonal(variance, "adam")
        return Estimate(
            self.states[i],
            covariance,
            first,
            last,
            linearizations=self.config.iterations,
            error_evaluations=2,
        )


def clip_groups(gradient: Float[Tensor, "b d"], norm: float) -> None:
    """Shorten the parts of every object's gradient that are longer, in place: pose, log-scale, code."""
    for group in _GROUPS:
        part = gradient[:, group]
        part *= norm / part.norm(dim=1, keepdim=True).clamp_min(norm)


def own_from_world_scale(state: ObjectState) -> Float[np.ndarray, "3 3"]:
    """Derivative of the log-scale along the object's axes w.r.t. that along the world's, shear left out."""
    return np.square(state.T_world_object.rotation().matrix()).T
