"""The paper's loss by its definition: SDF by the decoder's values alone, derivatives by differences, the rest in numpy."""

import numpy as np
import torch
from scipy.special import expit
from scipy.stats import norm

from factors.gaussian_depth import Deterministic, Probabilistic
from factors.state import ObjectState
from objgraph.estimate import AdamConfig
from objgraph.estimate.task import EstimationTask
from objgraph.estimate.terms import DrawnRays
from tests.objgraph.estimate.adam_cases import DECODER, DIM


def canonical_sdf(state: ObjectState, p_world: np.ndarray) -> np.ndarray:
    """G(z, p) with p = exp(-s) R^T (p_world - t)."""
    T = state.T_world_object
    p = (p_world - T.translation()) @ T.rotation().matrix() / np.exp(state.log_scale)
    return DECODER(torch.as_tensor(p), torch.as_tensor(np.array(state.code))[None]).numpy()


def metres_at(state: ObjectState, p_world: np.ndarray) -> np.ndarray:
    """Metres per canonical unit: how much the SDF changes a metre, inverted."""
    step = 1e-6
    gradient = np.stack(
        [
            (canonical_sdf(state, p_world + step * axis) - canonical_sdf(state, p_world - step * axis))
            / (2 * step)
            for axis in np.eye(3)
        ],
        axis=1,
    )
    return 1 / np.linalg.norm(gradient, axis=1)


def energy(mu: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    z = mu / sigma
    return sigma * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))


def rule(renderer) -> tuple[np.ndarray, np.ndarray]:
    """Standard-normal nodes and weights."""
    if renderer == Probabilistic(moments="sobol"):
        u = torch.quasirandom.SobolEngine(1, scramble=True, seed=0).draw(128, dtype=torch.float64)[:, 0]
        return -norm.ppf(u.numpy()), np.full(128, 1 / 128)
    x = np.linspace(-8, 8, 401)
    return x, norm.pdf(x) / norm.pdf(x).sum()


def depths(renderer, sdf, sigma, rays: DrawnRays, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of where each ray ends, sample by sample from the camera on."""
    x, weight = rule(renderer)
    uncertain = isinstance(renderer, Probabilistic)
    passed, mean, square = np.ones(len(sdf)), np.zeros(len(sdf)), np.zeros(len(sdf))
    depth, escape = rays.cells.depth.numpy(), 1.1 * rays.cells.far.numpy()
    origin = depth[:, 0]
    for k in range(sdf.shape[1]):
        s = sdf[:, k, None] + (sigma[:, k, None] * x if uncertain else 0.0 * x)
        occupied = expit(-slope * s) @ weight
        ends = passed * occupied
        mean += ends * (depth[:, k] - origin)
        square += ends * (depth[:, k] - origin) ** 2
        passed = passed * (1 - occupied)
    mean += passed * (escape - origin)
    square += passed * (escape - origin) ** 2
    variance = np.zeros(len(mean)) if renderer == Deterministic() else square - mean**2
    return mean + origin, np.sqrt(np.maximum(variance, 1e-12))


def depth_errors(renderer, sdf, sigma, rays: DrawnRays, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Rendered minus observed depth of the rays that say something (0 of the others), and its deviation."""
    mean, spread = depths(renderer, sdf, sigma, rays, slope)
    hit, far = rays.targets.hit.numpy(), rays.cells.far.numpy()
    target = np.where(hit, rays.targets.depth.numpy(), 1.1 * far)
    return np.where(hit | (rays.targets.end.numpy() >= far), mean - target, np.nan), spread


class Reference:
    """eq:final_loss of one object about a state, with its metres and its samples' place held."""

    def __init__(self, of: EstimationTask, config: AdamConfig, renderer, p_world, rays: DrawnRays) -> None:
        self.task, self.config, self.renderer, self.rays = of, config, renderer, rays
        self.state = of.starts[0]
        self.points = {"surface": p_world, "near": rays.p_near}
        self.metres = {name: metres_at(self.state, points) for name, points in self.points.items()}
        step = 1e-6
        self.jacobian = {
            name: np.stack(
                [
                    (self.sdf(name, step * axis) - self.sdf(name, -step * axis)) / (2 * step)
                    for axis in np.eye(DIM)
                ],
                axis=1,
            )
            for name in self.points
        }

    def sdf(self, name: str, delta: np.ndarray) -> np.ndarray:
        return self.metres[name] * canonical_sdf(self.state.retract(delta), self.points[name])

    def sigma(self, name: str, variance: np.ndarray) -> np.ndarray:
        """eq:sdf_variance; without uncertainty next to none."""
        if not self.config.uncertainty:
            return np.full(len(self.points[name]), 1e-6)
        return np.sqrt(np.square(self.jacobian[name]) @ variance)

    def along_rays(self, name: str, delta, variance) -> tuple[np.ndarray, np.ndarray]:
        """SDF and its deviation at all samples: what is not near stays as it was drawn, and certain."""
        near = self.rays.near.numpy()
        sdf, sigma = self.rays.sdf.numpy().copy(), np.zeros(near.shape)
        sdf[near], sigma[near] = self.sdf(name, delta), self.sigma(name, variance)
        return sdf, sigma

    def loss(self, delta: np.ndarray, variance: np.ndarray) -> float:
        config = self.config
        surface = energy(self.sdf("surface", delta), self.sigma("surface", variance))
        sdf, sigma = self.along_rays("near", delta, variance)
        error, spread = depth_errors(self.renderer, sdf, sigma, self.rays, config.steps.slope)
        counts = np.isfinite(error)
        code = self.state.retract(delta).code - self.task.prior.code_mean
        return (
            config.surface_weight * surface.mean()
            + config.render_weight * energy(error[counts], spread[counts]).sum() / self.rays.count
            + config.code_weight * np.mean(code**2)
        )

    def differences(self, function, at: np.ndarray, step: float = 1e-6) -> np.ndarray:
        return np.array(
            [(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(DIM)]
        )
