"""From a trained prior to one with a first guess: scenes of its training shapes, a network, what it does on held-out meshes."""

import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objgraph.errors import PriorError
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import digest
from objgraph.training.corpus import Corpus
from objgraph.training.guess_data import Shape, draw_all
from objgraph.training.guess_scenes import VIEWS, SceneConfig
from objgraph.training.mesh_files import canonical, read_mesh
from objgraph.training.train_guess import GuessQuality, TrainGuessConfig, measure_guess, train_guess

log = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with what is done, how much of it, and how much there is."""


def with_first_guess(
    prior: ShapePrior,
    codes: Float[np.ndarray, "s l"],
    corpus: Corpus,
    config: TrainGuessConfig,
    work: Path,
    jobs: int = 1,
    progress: Progress | None = None,
) -> ShapePrior:
    """The prior with a first guess, trained on scenes of the corpus' shapes as the prior makes them of their codes.

    What is done is kept in the folder `work`, and a killed run goes on there. The card says what the guess is worth on the
    corpus' held-out meshes.

    Raises:
        PriorError: none of the shapes is seen in any scene.
    """
    tell = progress or (lambda what, done, total: None)
    config = replace(config, network=replace(config.network, code_length=prior.decoder.code_length))
    settings = repr((digest(dict(prior.decoder.state_dict())), config.scenes, config.seed, SceneConfig()))
    cache = work / hashlib.sha256(settings.encode()).hexdigest()[:12]
    shapes = [
        Shape(shape.name, shape.extents, code=code)
        for shape, code in zip(corpus.training, codes, strict=True)
    ]
    some = np.sort(np.random.default_rng(config.seed).permutation(len(shapes))[: config.scenes])
    draws = draw_all(
        [shapes[i] for i in some], prior, max(1, config.scenes // len(shapes)), SceneConfig(), config.seed,
        cache / "training", jobs, lambda done, total: tell("drawing scenes", done, total),
    )  # fmt: skip
    guess = train_guess(
        draws, codes[some], prior.size_mean, config, cache / "checkpoint",
        lambda step, steps, loss: tell(f"training the first guess, loss {loss:.3f}", step, steps),
    )  # fmt: skip
    card: dict[str, object] = {"settings": asdict(config), "scenes": len(draws)}
    if corpus.unseen:
        meshes = [(entry.path, entry.file) for entry in corpus.unseen]
        quality = guess_quality(
            replace(prior, guess=guess), meshes, config.seed, cache / "heldout", jobs,
            progress=lambda done, total: tell("drawing held-out scenes", done, total),
        )  # fmt: skip
        card["heldout"] = {str(views): each.as_json() for views, each in quality.items()}
    return replace(prior, guess=guess, card={**prior.card, "first_guess": card})


def guess_quality(
    prior: ShapePrior,
    meshes: Sequence[tuple[Path, str]],
    seed: int,
    cache: Path,
    jobs: int = 1,
    each: int = 6,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, GuessQuality]:
    """What a prior's first guess is worth on scenes of these meshes (files and names) with one to three views.

    Raises:
        PriorError: the prior has none, or a mesh cannot be read, or none of them is seen in any scene.
    """
    if prior.guess is None:
        raise PriorError(f"the {prior.category} prior has no first guess")
    shapes = []
    for path, name in meshes:
        mesh = canonical(read_mesh(path), name)
        shapes.append(Shape(name, np.asarray(mesh.extents), mesh=mesh))
    draws = draw_all(shapes, prior, each, SceneConfig(), seed + 1, cache, jobs, progress)
    return {views: measure_guess(prior.guess, draws, prior.size_mean, views) for views in range(1, VIEWS + 1)}
