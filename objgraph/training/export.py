"""From a training to a prior that ships: statistics, measured errors, model card, attribution."""

import logging
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from factors.proportions import Proportions
from objgraph.errors import ProcessError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import save_prior
from objgraph.training.codes.fit import FitError, fit_error, typical_codes
from objgraph.training.codes.proportions import fit_proportions
from objgraph.training.decoder.train import TrainConfig, Trained, train
from objgraph.training.guess.command import with_first_guess
from objgraph.training.guess.data import Shape
from objgraph.training.meshes.corpus import Corpus, build_corpus
from objgraph.training.meshes.index import CadMesh
from objgraph.training.meshes.samples import SURFACE_POINTS, SdfSamples
from objgraph.training.progress import Report, bars
from objgraph.training.size import size_statistics
from objgraph.work import Workers, spread, threads

log = logging.getLogger(__name__)

_FEW = 12
"""Meshes that an attribution names one by one."""


def train_command(config: TrainConfig) -> Path:
    """Sample the shapes, train (or resume) with a progress bar, measure, and write `out/CATEGORY.safetensors`.

    Raises:
        PriorError: the meshes or the checkpoint cannot be used, or the training diverged.
    """
    corpus = _corpus(config)
    with bars() as show:

        def report(step: int, loss: float) -> None:
            show(f"training {config.category}, loss {loss:.5f}", step, config.steps)

        trained = train(config, corpus, report)
    return _write(config, corpus, trained)


def _corpus(config: TrainConfig) -> Corpus:
    cache = config.out / "cache" / config.category
    with bars("sampling ") as report:
        return build_corpus(
            config.category, config.meshes, config.corpus, config.samples, cache, config.jobs, report
        )


def _write(config: TrainConfig, corpus: Corpus, trained: Trained) -> Path:
    with bars() as report:
        prior = make_prior(config, corpus, trained, report)
    path = config.out / f"{config.category}.safetensors"
    save_prior(prior, path)
    if config.guess.steps:
        work = config.out / "guess" / config.category
        shapes = [
            Shape(shape.name, shape.extents, code=code)
            for shape, code in zip(corpus.training, trained.codes, strict=True)
        ]
        unseen = [(entry.path, entry.file) for entry in corpus.unseen]
        with threads(config.threads), bars() as report:
            prior = with_first_guess(prior, shapes, unseen, config.guess, work, config.jobs, report)
        save_prior(prior, path)
    log.info("%s: step %d, held out: %s", path, trained.step, prior.card["heldout"]["summary"])
    return path


def make_prior(
    config: TrainConfig, corpus: Corpus, trained: Trained, progress: Report | None = None
) -> ShapePrior:
    """The prior of a training, with what it does on shapes it has not seen in the card; `config.jobs` processes measure it.

    Raises:
        ProcessError: one of them died.
    """
    metric = [(entry.size, entry.source) for entry in corpus.used if entry.size is not None]
    size_mean, size_log_sigma, size_source = size_statistics(
        config.category, [size for size, _ in metric], [source for _, source in metric]
    )
    middle = trained.code_mean
    if trained.kinds is not None:  # between kinds there is no shape
        middle = trained.codes[np.linalg.norm(trained.codes - middle, axis=1).argmin()]
    prior = ShapePrior(
        category=config.category,
        decoder=trained.decoder,
        code_mean=middle.astype(np.float64),
        code_covariance=trained.code_covariance,
        kinds=trained.kinds,
        residual_sigma=0.01,
        size_mean=size_mean,
        size_log_sigma=size_log_sigma,
        prototypes=typical_codes(trained.codes),
        box=None if trained.box is None else trained.box.extents,
        anisotropy_sigma=None if trained.box is None else trained.box.anisotropy_sigma,
        proportions=_proportions(corpus, trained),
    )
    collected = {entry.file for entry in corpus.unseen}
    unseen = [shape for shape in corpus.heldout if _file(shape.name) in collected]
    procedural = [shape for shape in corpus.heldout if _file(shape.name) not in collected]
    fits = _fits(prior, [*unseen, *procedural[:5]], config.jobs, progress)
    errors, procedural_errors = fits[: len(unseen)], fits[len(unseen) :]
    by_people = {entry.file for entry in corpus.unseen if entry.maker == "people"}
    # a generator's held-out shapes are as those of its that were trained on: real ones are not
    unlike = [error for error in errors if _file(error.name) in by_people]
    bands = _bands(unlike or errors or procedural_errors)
    if not bands:
        log.warning(
            "%s: no shape was held out to measure the prior on: its residual of %g diagonals is a guess, and mapping "
            "trusts it", config.category, prior.residual_sigma
        )  # fmt: skip
    card = {
        "stands": config.stands,
        "data": {
            "collected": _attributed(corpus.used),
            "licences": sorted({entry.licence for entry in corpus.used}),
            "procedural": config.corpus.procedural,
            "training_shapes": len(corpus.training),
            "skipped": corpus.skipped,
        },
        "training": {
            "made_with": f"objgraph {version('objgraph')}",
            "steps": trained.step,
            "loss": trained.loss,
            "settings": {k: v for k, v in asdict(config).items() if k not in {"meshes", "out"}},
        },
        "heldout": {
            "collected": [entry.file for entry in corpus.unseen],
            "groups": sorted({entry.group for entry in corpus.unseen}),
            "summary": _summary(errors),
            "errors": [error.as_json() for error in errors],
            "procedural": _summary(procedural_errors),
            "measured": "best code by Levenberg-Marquardt on SDF samples; chamfer: mean of the two directed mean "
            f"distances of {SURFACE_POINTS} points, in box diagonals (equal surfaces: about 0.003)",
        },
        "residual_by_distance": bands,
        **({} if bands else {"residual_source": "a guess, not measured"}),
        "size_source": size_source,
    }
    return replace(prior, residual_sigma=next(iter(bands.values()), prior.residual_sigma), card=card)


def _proportions(corpus: Corpus, trained: Trained) -> Proportions | None:
    """Of the meshes as they are: warped copies, swaps and procedural shapes have proportions at random."""
    source = {f"{entry.file}#0": entry.source for entry in corpus.used}
    own = np.array([shape.name in source for shape in corpus.training], dtype=bool)
    if trained.box is None or not own.any():
        return None
    extents = np.array([shape.extents for shape in corpus.training])[own]
    sources = [source[shape.name] for shape in corpus.training if shape.name in source]
    return fit_proportions(trained.codes[own], extents, trained.box.extents, trained.code_covariance, sources)


def _file(shape: str) -> str:
    """The mesh that a collected shape's name is of: its copy's number stands after the last #."""
    return shape.rpartition("#")[0]


def _fits(
    prior: ShapePrior, shapes: Sequence[SdfSamples], jobs: int, progress: Report | None
) -> list[FitError]:
    """How the prior describes each shape."""
    found: dict[int, FitError] = {}
    for place, error in spread([partial(fit_error, prior, shape) for shape in shapes], Workers(jobs)):
        if isinstance(error, ProcessError):
            raise error
        found[place] = error
        if progress is not None:
            progress("fitting held-out shapes", len(found), len(shapes))
    return [found[place] for place in range(len(shapes))]


def _bands(errors: Sequence[FitError]) -> dict[str, float]:
    """The median over shapes of the error in each band, nearest to the surface first."""
    names = dict.fromkeys(name for error in errors for name in error.bands)
    return {
        name: float(np.median([error.bands[name] for error in errors if name in error.bands]))
        for name in names
    }


def _summary(errors: Sequence[FitError]) -> dict[str, float | int | None]:
    """Medians and means over shapes."""
    if not errors:
        return {"count": 0}
    chamfers = np.array([error.chamfer for error in errors])
    found = chamfers[np.isfinite(chamfers)]
    return {
        "count": len(errors),
        "without_surface": int(len(chamfers) - len(found)),
        "chamfer_median": float(np.median(found)) if len(found) else None,
        "chamfer_mean": float(found.mean()) if len(found) else None,
        "gradient_median": float(np.median([error.gradient_median for error in errors])),
    }


def _attributed(meshes: Sequence[CadMesh]) -> list[dict[str, Any]]:
    """What is owed to whom, each with the meshes that it is owed for; a generator's once for all."""
    files: dict[tuple[str, str, str], list[str]] = {}
    generated: dict[str, str] = {}
    for mesh in meshes:
        by_people = mesh.maker == "people"
        words = mesh.attribution if by_people else generated.setdefault(mesh.source, mesh.attribution)
        files.setdefault((mesh.source, mesh.licence, words), []).append(mesh.file)
    return [
        {"source": source, "licence": licence, "attribution": words, "files": sorted(names)}
        for (source, licence, words), names in sorted(files.items())
    ]


def attribution(priors: Sequence[ShapePrior]) -> str:
    """The attribution list of the collected meshes that shipped priors were trained on."""
    lines = [
        "The decoder weights in this folder were trained on the meshes below, re-oriented, centred, rescaled and",
        "warped, and on procedural meshes. The meshes themselves are not distributed.",
        "Licences: CC BY 4.0 https://creativecommons.org/licenses/by/4.0/ - CC BY 3.0",
        "https://creativecommons.org/licenses/by/3.0/ - CC0 1.0 https://creativecommons.org/publicdomain/zero/1.0/",
        "- MIT-0 https://opensource.org/license/mit-0 - MIT https://opensource.org/license/mit - BSD-3-Clause",
        "https://opensource.org/license/bsd-3-clause - Apache-2.0 https://www.apache.org/licenses/LICENSE-2.0",
        "",
    ]
    for prior in priors:
        lines.append(f"{prior.category}.safetensors")
        owed = prior.card["data"]["collected"]
        for source, licence in sorted({(entry["source"], entry["licence"]) for entry in owed}):
            lines.append(f" {source} ({licence})")
            for entry in owed:
                if (entry["source"], entry["licence"]) == (source, licence):
                    names = entry["files"]
                    which = (
                        ", ".join(names)
                        if len(names) <= _FEW
                        else f"{len(names)} meshes, {names[0]} to {names[-1]}"
                    )
                    lines.append(f"  {which}: {entry['attribution']}")
        lines.append("")
    return "\n".join(lines)
