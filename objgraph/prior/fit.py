"""Best codes of given shapes, and how well a decoder then describes them: the prior's own evaluation."""

from dataclasses import asdict, dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from trimesh import Trimesh
from trimesh.sample import sample_surface

from factors.decoder import Decoder
from objgraph.errors import SolveError
from objgraph.mesh import extract_mesh
from objgraph.prior.samples import SdfSamples

_BAND = 0.01


@dataclass(frozen=True)
class FitError:
    """How a decoder describes one shape with its best code. Canonical units."""

    name: str
    chamfer: float
    """Mean of the two directed mean distances between surfaces; NaN where nothing came out or is known."""
    surface_sigma: float
    """Robust standard deviation of the SDF error within 0.01 of the surface."""
    gradient_median: float
    """Median norm of the SDF's gradient over the whole box; 1 for a true distance."""

    def as_json(self) -> dict[str, float | str | None]:
        """For the card; NaN becomes null."""
        return {k: v if isinstance(v, str) or np.isfinite(v) else None for k, v in asdict(self).items()}


def fit_code(
    decoder: Decoder,
    samples: SdfSamples,
    mean: Float[np.ndarray, "l"],
    covariance: Float[np.ndarray, "l l"],
    iterations: int = 12,
    points: int = 2000,
    sigma: float = 0.01,
    effective: float = 300.0,
    seed: int = 0,
) -> Float[np.ndarray, "l"]:
    """The most probable code of a shape, by Levenberg-Marquardt on reweighted SDF errors and the code prior.

    `sigma` is the error's scale on the surface; it grows away from it as the training loss's weight falls.
    `effective` counts the samples as that many independent ones against the prior.
    """
    rng = np.random.default_rng(seed)
    row = rng.choice(len(samples.sdf), min(points, len(samples.sdf)), replace=False)
    xyz, sdf = torch.from_numpy(samples.points[row]), torch.from_numpy(samples.sdf[row])
    deviation = sigma * (1 + sdf.abs().numpy() / 0.05)
    information = np.linalg.inv(covariance + 1e-8 * np.trace(covariance) / len(mean) * np.eye(len(mean)))
    code, damping = mean.copy(), 1e-3

    def linearized(z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        jet = decoder.linearize(xyz, torch.from_numpy(z[None].astype(np.float32)))
        error = (jet.value - sdf).double().numpy() / deviation
        jacobian = jet.d_code.double().numpy() / deviation[:, None]
        # Huber's loss at one deviation, as the training loss is an absolute one
        size = np.abs(error)
        weight = effective / len(row) * np.where(size > 1, 1 / np.maximum(size, 1), 1.0)
        rho = np.where(size > 1, 2 * size - 1, size**2)
        offset = z - mean
        cost = effective / len(row) * rho.sum() + offset @ information @ offset
        hessian = jacobian.T @ (weight[:, None] * jacobian) + information
        return cost, jacobian.T @ (weight * error) + information @ offset, hessian

    cost, gradient, hessian = linearized(code)
    for _ in range(iterations):
        trial = code - np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
        trial_cost, trial_gradient, trial_hessian = linearized(trial)
        if trial_cost < cost:
            done = cost - trial_cost < 1e-4 * cost
            code, cost, gradient, hessian = trial, trial_cost, trial_gradient, trial_hessian
            damping = max(damping / 5, 1e-6)
            if done:
                break
        else:
            damping *= 5
    return code


def fit_error(
    decoder: Decoder,
    samples: SdfSamples,
    mean: Float[np.ndarray, "l"],
    covariance: Float[np.ndarray, "l l"],
    resolution: int = 128,
) -> FitError:
    """Fit a shape and measure what is left."""
    code = fit_code(decoder, samples, mean, covariance)
    return code_error(decoder, code, samples, resolution)


def code_error(
    decoder: Decoder, code: Float[np.ndarray, "l"], samples: SdfSamples, resolution: int = 128
) -> FitError:
    """The errors of a shape under a given code."""
    z = torch.from_numpy(code[None].astype(np.float32))
    jet = decoder.linearize(torch.from_numpy(samples.points), z)
    near = np.abs(samples.sdf) < _BAND
    error = (jet.value.numpy() - samples.sdf)[near]
    sigma = 1.4826 * np.median(np.abs(error - np.median(error))) + abs(np.median(error))
    try:
        mesh = extract_mesh(decoder, code, resolution, remove_floaters=False)
        chamfer = _chamfer(mesh, samples)
    except SolveError:
        chamfer = float("nan")
    norms = jet.d_point.norm(dim=1).numpy()
    return FitError(samples.name, chamfer, float(sigma), float(np.median(norms[-len(norms) // 4 :])))


def _chamfer(mesh: Trimesh, samples: SdfSamples) -> float:
    """Mean of the two directed mean distances between points drawn on either surface."""
    truth = samples.surface
    if truth is None:
        return float("nan")
    decoded = sample_surface(mesh, len(truth), seed=0)[0]
    there = cKDTree(truth).query(decoded)[0].mean()
    back = cKDTree(decoded).query(truth)[0].mean()
    return float(there + back) / 2


def code_statistics(
    codes: Float[np.ndarray, "s l"],
) -> tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l l"]]:
    """Mean and covariance of the training codes, in float64; with a ridge that keeps it regular."""
    codes = codes.astype(np.float64)
    covariance = np.cov(codes, rowvar=False)
    ridge = 1e-3 * np.trace(covariance) / codes.shape[1]
    return codes.mean(0), covariance + ridge * np.eye(codes.shape[1])


def typical_codes(
    codes: Float[np.ndarray, "s l"], count: int = 12, seed: int = 0
) -> Float[np.ndarray, "k l"]:
    """Training codes nearest to the centres of `count` clusters of them."""
    count = min(count, len(codes))
    centres, _ = kmeans2(codes.astype(np.float64), count, minit="++", rng=np.random.default_rng(seed))
    nearest = np.unique(np.linalg.norm(codes[None] - centres[:, None], axis=2).argmin(axis=1))
    return codes[nearest].astype(np.float64)
