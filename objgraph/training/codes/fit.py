"""Best codes of given shapes, and how well a decoder then describes them: the prior's own evaluation."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from trimesh import Trimesh
from trimesh.sample import sample_surface

from objgraph.errors import SolveError
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.codes.search import sample_rows, search
from objgraph.training.codes.stretch import multiplied, to_decoder
from objgraph.training.meshes.samples import SdfSamples

BANDS = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 1.0)
"""Limits of the bands of distance from the surface in which errors are measured, in diagonals."""

_FIT_POINTS = 4000


@dataclass(frozen=True)
class FitError:
    """How a decoder describes one shape with its best code. Canonical units."""

    name: str
    chamfer: float
    """Mean of the two directed mean distances between surfaces; NaN where nothing came out or is known."""
    bands: dict[str, float]
    """Root mean square of the SDF error by the distance from the surface, in diagonals."""
    gradient_median: float
    """Median norm of the SDF's gradient over the whole box; 1 for a true distance."""

    def as_json(self) -> dict[str, Any]:
        """For the card, four digits of each number; NaN becomes null."""
        return {
            "name": self.name,
            "chamfer": _short(self.chamfer) if np.isfinite(self.chamfer) else None,
            "bands": {name: _short(error) for name, error in self.bands.items()},
            "gradient_median": _short(self.gradient_median),
        }


def _short(number: float) -> float:
    return float(f"{number:.4g}")


def fit_error(prior: ShapePrior, samples: SdfSamples, resolution: int = 128) -> FitError:
    """Fit a shape with a prior's decoder and codes, and measure what is left."""
    stretch = to_decoder(prior, samples.extents)
    rows = sample_rows(samples, stretch)
    code = search(prior, rows.thinned(_FIT_POINTS, np.random.default_rng(0))).codes[0]
    like = prior.decoder.like
    jet = prior.decoder.linearize(
        torch.from_numpy(rows.points).to(like), torch.from_numpy(code[None]).to(like)
    )
    error = jet.value.cpu().numpy() - samples.sdf
    try:
        mesh = multiplied(extract_mesh(prior.decoder, code, resolution, remove_floaters=False), stretch)
        chamfer = _chamfer(mesh, samples)
    except SolveError:
        chamfer = float("nan")
    slope = (jet.d_point.cpu().numpy() / stretch)[-len(error) // 4 :]
    return FitError(
        name=samples.name,
        chamfer=chamfer,
        bands={
            f"{low:g}-{high:g}": float(np.sqrt(np.mean(error[inside] ** 2)))
            for low, high in pairwise(BANDS)
            if (inside := (np.abs(samples.sdf) >= low) & (np.abs(samples.sdf) < high)).any()
        },
        gradient_median=float(np.median(np.linalg.norm(slope, axis=1))),
    )


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
    covariance = np.atleast_2d(np.cov(codes, rowvar=False))  # of one number it has no axes
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
