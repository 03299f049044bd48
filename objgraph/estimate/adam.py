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

from factors.gaussian_depth import Probabilistic
from factors.rendering import RaySamples, Renderer
from factors.score import energy_score, energy_score_monte_carlo
from factors.sdf_decoder import SdfDecoder
from factors.state import RIGID_DOF, ObjectState
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.errors import SolveError
from objgraph.estimate.pool import Pool
from objgraph.estimate.standing import Standing
from objgraph.estimate.task import Estimate, EstimationTask, unusable
from objgraph.estimate.terms import DrawnRays, Linearized, RaySteps, draw_rays, linearize

_LEAST_SIGMA = 1e-6
"""Metres; the energy score of a surer distance is its absolute value."""


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
    another decoder; of 3000, 300 and 30 this one served the shipped priors best (docs/evaluation.md)."""
    uncertainty: bool = True
    """Whether the covariance is estimated and scored; without it the scores are absolute errors (DSP-SLAM)."""
    pose_variance: float = 1e-4
    """First variance of rotation, translation and log-scale."""
    code_variance: float = 1e-6
    """First variance of the code."""
    monte_carlo: int | None = None
    """Samples of the paper's estimate of the 3D energy score (1000 there); by default the closed form."""
    standing: bool = False
    """Whether the graph's factors for floor and gravity are in the loss, at weight one."""
    seed: int = 0
    """Of the points and rays drawn."""


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
        self.rngs = [np.random.default_rng(config.seed) for _ in tasks]
        length = self.decoder.code_length
        variance = [config.pose_variance] * RIGID_DOF + [config.code_variance] * length
        like = self.decoder.like
        self.log_variance = torch.tensor(variance).log().repeat(len(tasks), 1).to(like).requires_grad_()
        self.delta = torch.zeros_like(self.log_variance).requires_grad_()
        self.code_mean = torch.stack(
            [torch.as_tensor(np.asarray(task.prior.code_mean, float)).to(like) for task in tasks]
        )
        self.standing = [Standing(task) for task in tasks] if config.standing else []
        self.failures: dict[int, str] = {}

    def run(self, progress: Callable[[int], None]) -> list[Estimate | SolveError]:
        optimizer = torch.optim.Adam([self.delta, self.log_variance], lr=self.config.learning_rate)
        judged = drawn = self._draw()
        rays = self._rays(drawn)
        with torch.no_grad():
            first = self._losses(drawn, rays, 0)
        for i in range(self.config.iterations):
            if i > 0 and i % self.config.redraw == 0:
                drawn = self._draw()
                rays = self._rays(drawn)
            self._gradients(drawn, rays, i)
            optimizer.step()
            self._move()
            progress(i + 1)
        # on the points and rays of the first, so that the two can be compared
        rays = self._rays(judged)
        with torch.no_grad():
            last = self._losses(judged, rays, 0)
        return [self._result(i, float(first[i]), float(last[i])) for i in range(len(self.tasks))]

    def _draw(self) -> list[Pool]:
        config = self.config
        return [
            pool.draw(rng, config.points, config.rays)
            for pool, rng in zip(self.pools, self.rngs, strict=True)
        ]

    def _rays(self, drawn: Sequence[Pool]) -> list[DrawnRays]:
        """Samples along the rays where the objects are now; the floor's rays too are drawn."""
        for standing, state in zip(self.standing, self.states, strict=False):
            standing.refresh(state)
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
        return loss.detach()

    def _losses(self, drawn: Sequence[Pool], rays: Sequence[DrawnRays], iteration: int) -> Float[Tensor, "b"]:
        points = [each.p_world for each in drawn]
        both = linearize(
            self.decoder,
            self.states,
            [np.concatenate([p, r.p_near]) for p, r in zip(points, rays, strict=True)],
        )
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
        if self.standing:
            loss = loss + self.standing[i].loss(self.states[i], self.delta[i])
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
        return loss

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
                    self.states[i] = self.states[i].retract(step)
            self.delta.zero_()

    def _result(self, i: int, first: float, last: float) -> Estimate | SolveError:
        task = self.tasks[i]
        if i in self.failures:
            return SolveError(f"{task.name}: {self.failures[i]}")
        covariance = None
        if self.config.uncertainty:
            variance = self.log_variance[i].detach().exp().cpu().double().numpy()
            covariance = ObjectCovariance.diagonal(variance, "adam")
        return Estimate(
            self.states[i],
            covariance,
            first,
            last,
            linearizations=self.config.iterations,
            error_evaluations=2,
        )
