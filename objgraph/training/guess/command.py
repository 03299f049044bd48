"""From a prior to one with a first guess: scenes of its shapes, a network, and what it does on meshes that it never saw."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from factors import checks
from objgraph.errors import ConfigError, PriorError
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import digest, save_prior
from objgraph.training.guess.data import Draws, Shape, draw_all
from objgraph.training.guess.scenes import VIEWS, SceneConfig
from objgraph.training.guess.shapes import known_shapes, random_shapes
from objgraph.training.guess.train import GuessQuality, TrainGuessConfig, measure_guess, train_guess
from objgraph.training.meshes.corpus import listed
from objgraph.training.meshes.files import canonical, read_mesh
from objgraph.training.meshes.folder import choose_meshes
from objgraph.training.progress import Report, bars


@dataclass(frozen=True)
class GuessCommand:
    """Give a prior a first guess, trained on the meshes that it has seen and on shapes of random codes."""

    prior: str
    """A shipped category, or a .safetensors file."""
    out: Path
    """The prior to write, with the guess."""
    meshes: tuple[Path, ...] = ()
    """Folders of meshes: it learns from those that the prior was trained on, and is measured on those that the prior's card names as
    held out; on all of a folder of which it names none."""
    shapes: int = 3500
    """Random codes. Half of the scenes are of them, half of the meshes that the prior has seen, if there are any."""
    spread: float = 1.0
    """Factor on the standard deviations that the prior gives its codes: a third for those whose covariance is nine times that of
    the training codes, whose random codes would be no shapes."""
    work: Path = Path("out/guess")
    """Folder for scenes and checkpoint; a killed run goes on there."""
    jobs: int = 1
    """Processes that draw scenes."""
    guess: TrainGuessConfig = field(default_factory=TrainGuessConfig)
    """How it is trained."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a number is not one of its kind."""
        checks.settings(
            self, ConfigError, shapes=checks.Range(1), spread=checks.POSITIVE, jobs=checks.Range(1)
        )


def guess_command(command: GuessCommand) -> Path:
    """Draw, train and measure with progress bars, and write the prior.

    Raises:
        PriorError: there is no such prior, or none of its shapes is seen in any scene.
        EvaluationError: there are no meshes to measure it on in the folders given.
    """
    prior = load_prior(command.prior)
    unseen, seen = [], []
    if command.meshes:
        chosen = choose_meshes(command.meshes, prior.category, prior)
        unseen = list(zip(chosen.paths, chosen.names, strict=True))
        seen = [mesh for mesh in listed(command.meshes, prior.category) if mesh.path not in chosen.paths]
    work = command.work / prior.category
    with bars() as report:
        known = known_shapes(prior, seen, work, command.jobs, report)
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

    What is done is kept in the folder `work`, and a killed run goes on there. The card says what the guess is worth on the
    `unseen` meshes (files and names).

    Raises:
        PriorError: none of the shapes is seen in any scene, or a mesh cannot be read.
    """
    tell = progress or (lambda what, done, total: None)
    config = replace(config, network=replace(config.network, code_length=prior.decoder.code_length))
    rng = np.random.default_rng(config.seed)
    rounds = [rng.permutation(len(shapes)) for _ in range(-(-config.scenes // len(shapes)))]
    drawn = [shapes[i] for i in np.sort(np.concatenate(rounds)[: config.scenes])]
    codes = np.array([shape.code for shape in drawn])
    made = [(shape.extents.tobytes(), shape.mesh is None) for shape in drawn]
    settings = digest(dict(prior.decoder.state_dict())), codes.tobytes(), made, config.seed
    kept = [each.name for each in fields(Draws)]
    cache = work / _key(*settings, SceneConfig(), kept)
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
    if unseen:
        quality = guess_quality(
            replace(prior, guess=guess), unseen, config.seed, cache / f"heldout-{_key(unseen)}", jobs,
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


def _key(*settings: object) -> str:
    """A folder's name for what depends on these."""
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:12]
