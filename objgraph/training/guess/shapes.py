"""The shapes that a first guess learns from, where a prior's own training is not at hand."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from objgraph.atomic import write_file
from objgraph.errors import PriorError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import digest
from objgraph.training.codes.search import sample_rows, search
from objgraph.training.codes.stretch import to_decoder
from objgraph.training.guess.data import Shape
from objgraph.training.meshes.corpus import sample_meshes
from objgraph.training.meshes.files import canonical, read_mesh
from objgraph.training.meshes.index import CadMesh
from objgraph.training.meshes.samples import SampleConfig, SdfSamples
from objgraph.training.progress import Report
from objgraph.work import in_order, process_pool

_WITHIN = 2.0
"""Standard deviations, along each axis, within which random codes are drawn."""
_FIT_POINTS = 2000


def known_shapes(
    prior: ShapePrior, meshes: Sequence[CadMesh], work: Path, jobs: int = 1, progress: Report | None = None
) -> list[Shape]:
    """Meshes that a prior was trained on, each with its best code, which is kept in the folder `work`.

    Raises:
        PriorError: a mesh cannot be read, or what is kept cannot be written.
    """
    if not meshes:
        return []
    pairs = sample_meshes(meshes, SampleConfig(), work / "samples", jobs, progress)
    decoder = digest(dict(prior.decoder.state_dict()))
    cache = work / f"codes-{decoder[:12]}"
    shapes: list[Shape] = []
    with process_pool(jobs, PriorError) as pool:
        codes = in_order(pool, (partial(_best_code, samples, prior, cache) for _, samples in pairs))
        for (entry, samples), code in zip(pairs, codes, strict=True):
            mesh = canonical(read_mesh(entry.path), entry.file)
            shapes.append(Shape(entry.file, samples.extents, code, mesh, entry.source))
            if progress is not None:
                progress("looking for their codes", len(shapes), len(pairs))
    return shapes


def random_shapes(
    prior: ShapePrior, count: int, seed: int, spread: float = 1.0, known: Sequence[Shape] = ()
) -> list[Shape]:
    """Random codes, whose deviations are `spread` times the prior's; each with the proportions of the known shape whose code is
    nearest, or without any with those of a random object: the code's own where the prior has no box that shapes are stretched to."""
    rng = np.random.default_rng(seed)
    codes = prior.code_mean + spread * (prior.draw_codes(count, rng, _WITHIN) - prior.code_mean)
    if known:
        extents = _of_nearest(codes, known)
    elif prior.box is None:
        extents = [None] * count
    else:
        if (said := prior.proportions) is None:
            u = rng.normal(0, prior.anisotropy_sigma or 0.0, (count, 3))
        else:
            u = said.of(codes) + rng.multivariate_normal(np.zeros(3), said.covariance, count)
        edges = prior.box * np.exp(u)
        extents = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    return [Shape(f"random {i}", extents[i], code=codes[i]) for i in range(count)]


def _of_nearest(codes: Float[np.ndarray, "n l"], known: Sequence[Shape]) -> Float[np.ndarray, "n 3"]:
    theirs = np.array([shape.code for shape in known])
    nearest = [int(np.square(theirs - code).sum(axis=1).argmin()) for code in codes]
    return np.array([known[i].extents for i in nearest])


def _best_code(samples: SdfSamples, prior: ShapePrior, cache: Path) -> Float[np.ndarray, "l"]:
    key = hashlib.sha256(np.ascontiguousarray(samples.points).tobytes()).hexdigest()[:24]
    path = cache / f"{key}.safetensors"
    with suppress(SafetensorError, FileNotFoundError):
        return load_file(path)["code"]
    rows = sample_rows(samples, to_decoder(prior, samples.extents))
    code = search(prior, rows.thinned(_FIT_POINTS, np.random.default_rng(0))).codes[0]
    write_file(path, save({"code": code}), PriorError)
    return code
