"""From a prior to one with a first guess: scenes of its shapes, a network, and what it does on meshes that it never saw."""

import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import trimesh

from factors import checks
from objgraph.atomic import check_place
from objgraph.errors import ConfigError, PriorError
from objgraph.priors.first_guess import FirstGuess
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import digest, save_prior
from objgraph.training.codes.proportions import fit_proportions
from objgraph.training.guess.data import Draws, Shape, draw_all
from objgraph.training.guess.scenes import VIEWS, SceneConfig
from objgraph.training.guess.shapes import known_shapes, random_shapes
from objgraph.training.guess.train import GuessQuality, TrainGuessConfig, measure_guess, train_guess
from objgraph.training.meshes.corpus import listed
from objgraph.training.meshes.files import MeshError, canonical, read_mesh
from objgraph.training.meshes.folder import choose_meshes, trained_on
from objgraph.training.meshes.solid import require_depth
from objgraph.training.progress import Report, bars
from objgraph.work import threads

log = logging.getLogger(__name__)

_SCENES = 6
"""Of each held-out mesh."""


@dataclass(frozen=True)
class GuessCommand:
    """Give a prior a first guess, trained on the meshes that it has seen and on shapes of random codes."""

    prior: str
    """A shipped category, or a .safetensors file."""
    out: Path
    """The prior to write, with the guess."""
    meshes: tuple[Path, ...] = ()
    """Folders of meshes: it learns from those that the prior's card names as trained on, and is measured on those that it names as
    held out; of a folder of which it names none as held out, on all others."""
    shapes: int = 3500
    """Random codes. Half of the scenes are of them, half of the meshes that the prior has seen, if there are any."""
    spread: float = 1.0
    """Factor on the standard deviations that the prior gives its codes: a third for those whose covariance is nine times that of
    the training codes, whose random codes would be no shapes."""
    work: Path = Path("out/guess")
    """Folder for scenes and checkpoint; a killed run goes on there."""
    jobs: int = 1
    """Processes that draw scenes."""
    threads: int = 1
    """CPU threads of the training."""
    guess: TrainGuessConfig = field(default_factory=TrainGuessConfig)
    """How it is trained."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        some = checks.Range(1)
        checks.settings(self, ConfigError, shapes=some, spread=checks.POSITIVE, jobs=some, threads=some)


def guess_command(command: GuessCommand) -> Path:
    """Draw, train and measure with progress bars, and write the prior.

    Raises:
        ConfigError: it is to be trained for no step.
        PriorError: there is no such prior, none of its shapes is seen in any scene, or `out` cannot be written or is no .safetensors.
        EvaluationError: there are no meshes to measure it on in the folders given.
    """
    if command.guess.steps == 0:
        raise ConfigError("--guess.steps is 0: a first guess that was not trained says nothing, give more")
    if command.out.suffix != ".safetensors":
        raise PriorError(f"--out {command.out} must end in .safetensors")
    check_place(command.out, PriorError)
    prior = load_prior(command.prior)
    unseen, seen = [], []
    if command.meshes:
        chosen = choose_meshes(command.meshes, prior.category, prior)
        files = trained_on(prior.card)
        seen = [mesh for mesh in listed(command.meshes, prior.category) if mesh.file in files]
        paths = {mesh.path for mesh in seen}
        pairs = zip(chosen.paths, chosen.names, strict=True)
        unseen = [(path, name) for path, name in pairs if path not in paths]
    work = command.work / prior.category
    with threads(command.threads), bars() as report:
        known = known_shapes(prior, seen, work, command.jobs, report)
        if prior.box is not None and known:
            codes, extents = (
                np.array([getattr(each, name) for each in known]) for name in ("code", "extents")
            )
            sources = [each.source for each in known]
            found = fit_proportions(codes, extents, prior.box, prior.code_covariance, sources)
            prior = replace(prior, proportions=found or prior.proportions)
        drawn = random_shapes(prior, command.shapes, command.guess.seed, command.spread, known)
        often = -(-len(drawn) // len(known)) if known else 0
        shapes = [*known * often, *drawn]
        prior = with_first_guess(prior, shapes, unseen, command.guess, work, command.jobs, report)
    save_prior(prior, command.out)
    return command.out


def with_first_guess(
    prior: ShapePrior,
    shapes: Sequence[Shape],
    unseen: Sequence[tuple[Path, str]],
    config: TrainGuessConfig,
    work: Path,
    jobs: int = 1,
    progress: Report | None = None,
) -> ShapePrior:
    """The prior with a first guess, trained on scenes of shapes: of their meshes, or as the prior makes them of their codes.

    What is done is kept in the folder `work`, and a killed run goes on there. The card says what the guess is worth on those of
    the `unseen` meshes (files and names) that can be read.

    Raises:
        PriorError: none of the shapes is seen in any scene, or none of the unseen meshes is.
    """
    tell = progress or (lambda what, done, total: None)
    config = replace(config, network=replace(config.network, code_length=prior.decoder.code_length))
    rng = np.random.default_rng(config.seed)
    rounds = [rng.permutation(len(shapes)) for _ in range(-(-config.scenes // len(shapes)))]
    drawn = [shapes[i] for i in np.sort(np.concatenate(rounds)[: config.scenes])]
    codes = np.array([shape.code for shape in drawn])
    made = [(None if s.extents is None else s.extents.tobytes(), s.mesh is None) for s in drawn]
    box = None if prior.box is None else prior.box.tobytes()
    sizes = prior.stands, prior.size_mean, prior.size_log_sigma, box
    settings = digest(dict(prior.decoder.state_dict())), codes.tobytes(), made, config.seed, sizes
    kept = [each.name for each in fields(Draws)]
    cache = work / _key(*settings, SceneConfig(), kept)
    scenes, judged = None, _readable(unseen)
    if judged:  # what is wrong with them is found before hours of training, not after
        named = [(shape.name, _key(*_bytes_of(shape.mesh))) for shape in judged]
        scenes = _unseen_scenes(
            prior, judged, config.seed, cache / f"heldout-{_key(named)}", jobs,
            lambda done, total: tell("drawing held-out scenes", done, total),
        )  # fmt: skip
    draws = draw_all(
        drawn, prior, 1, SceneConfig(), config.seed, cache / "training", jobs,
        lambda done, total: tell("drawing scenes", done, total),
    )  # fmt: skip
    guess = train_guess(
        draws, codes, prior.size_mean, config, cache / f"checkpoint-{_key(config)}",
        lambda step, steps, loss: tell(f"training the first guess, loss {loss:.3f}", step, steps),
    )  # fmt: skip
    card: dict[str, object] = {
        "settings": asdict(config),
        "shapes": len(np.unique(codes, axis=0)),
        "scenes": len(draws),
    }
    if scenes is not None:
        quality = _quality(guess, scenes, prior.size_mean)
        card["heldout"] = {str(views): each.as_json() for views, each in quality.items()}
    return replace(prior, guess=guess, card={**prior.card, "first_guess": card})


def guess_quality(
    prior: ShapePrior,
    meshes: Sequence[tuple[Path, str]],
    seed: int,
    cache: Path,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, GuessQuality]:
    """What a prior's first guess is worth on scenes of those of these meshes (files and names) that can be read, by the number of
    views, one to three, in which any of them is seen.

    Raises:
        PriorError: the prior has none, or none of the meshes is seen in any scene.
    """
    if prior.guess is None:
        raise PriorError(f"the {prior.category} prior has no first guess")
    scenes = _unseen_scenes(prior, _readable(meshes), seed, cache, jobs, progress)
    return _quality(prior.guess, scenes, prior.size_mean)


def _readable(meshes: Sequence[tuple[Path, str]]) -> list[Shape]:
    """Meshes in their own proportions; of one that cannot be read, or is flat, it is said, and why."""
    shapes = []
    for path, name in meshes:
        try:
            mesh = canonical(read_mesh(path), name)
            require_depth(mesh.extents, str(path))
        except MeshError as error:
            log.warning("%s is left out of what the first guess is measured on: %s", name, error)
            continue
        shapes.append(Shape(name, np.asarray(mesh.extents), mesh=mesh))
    return shapes


def _bytes_of(mesh: trimesh.Trimesh | None) -> tuple[bytes, ...]:
    """What tells a mesh from the same one turned."""
    return () if mesh is None else (np.asarray(mesh.vertices).tobytes(), np.asarray(mesh.faces).tobytes())


def _unseen_scenes(
    prior: ShapePrior,
    shapes: Sequence[Shape],
    seed: int,
    cache: Path,
    jobs: int,
    progress: Callable[[int, int], None] | None,
) -> Draws:
    return draw_all(shapes, prior, _SCENES, SceneConfig(), seed + 1, cache, jobs, progress)


def _quality(guess: FirstGuess, scenes: Draws, unit: float) -> dict[int, GuessQuality]:
    return {
        views: measure_guess(guess, scenes, unit, views)
        for views in range(1, VIEWS + 1)
        if (scenes.views >= views).any()
    }


def _key(*settings: object) -> str:
    """A folder's name for what depends on these."""
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:12]
