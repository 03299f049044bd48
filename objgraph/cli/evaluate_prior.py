"""What the command line does with shape priors: `objgraph evaluate-prior`."""

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import tyro
from rich.console import Console

from objgraph.cli.progress import progress
from objgraph.errors import EvaluationError
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.training.guess.command import guess_quality
from objgraph.training.guess.train import GuessQuality
from objgraph.training.meshes.folder import Choice, ChosenMeshes, choose_meshes, write_json
from objgraph.training.quality.evaluate import PriorEvaluationConfig, ShapeRow, evaluate_meshes
from objgraph.training.quality.random_codes import check_random_codes
from objgraph.training.quality.report import document, table

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EvaluatePriorCommand:
    """Measure a shape prior on folders of meshes.

    Meshes have y up and the front at -z; they are centred on their bounding box and scaled to a diagonal of 1.
    """

    category: str
    """Category of the meshes."""
    meshes: tuple[Path, ...]
    """Folders of ply, obj, stl, off or glb files, at any depth; or of such with an index.json."""
    json: Path
    """File for the numbers."""
    prior: Path | None = None
    """The prior's .safetensors file; by default the category's shipped one."""
    heldout: bool = False
    """Only meshes that the prior's card names as held out: the default where there are any."""
    all: bool = False
    """Every mesh, trained on or not."""
    jobs: int = 1
    """Processes."""
    random_codes: int = 0
    """Also mesh this many random codes within two standard deviations, and count those without a surface, in one piece,
    and as large as the box that all shapes fill."""
    config: Annotated[PriorEvaluationConfig, tyro.conf.arg(name="")] = field(
        default_factory=PriorEvaluationConfig
    )
    """How it is measured."""


def run_evaluate_prior(command: EvaluatePriorCommand, console: Console) -> dict[str, Any]:
    """Evaluate, write the JSON document, and show a table.

    Raises:
        EvaluationError: there is nothing to evaluate, or the file cannot be written; no file is left then.
        PriorError: the prior or the folder's index cannot be used.
    """
    _check(command)
    prior = load_prior(command.prior or command.category)
    choice: Choice = "heldout" if command.heldout else "all" if command.all else "default"
    meshes = choose_meshes(command.meshes, command.category, prior, choice)
    console.print(f"{len(meshes.names)} meshes: {meshes.chosen}", markup=False)
    count = len(meshes.names)
    with progress(console, transient=True) as tell:

        def report(done: int, total: int, row: ShapeRow) -> None:
            tell(f"fitted {row.mesh}", done, total)

        rows = evaluate_meshes(prior, meshes, command.config, command.jobs, report)
        random_codes = None
        if command.random_codes:
            tell("meshing random codes", count, count)
            random_codes = check_random_codes(
                prior, command.random_codes, seed=command.config.seed, jobs=command.jobs
            )
        guess = _guess(
            command, prior, meshes, rows,
            lambda done, total: tell("drawing scenes for the first guess", done, total),
        )  # fmt: skip
    prior_file = str(command.prior or f"{prior.category}.safetensors as shipped")
    result = document(prior, prior_file, meshes, rows, command.config, random_codes, guess)
    write_json(result, command.json)
    console.print(table(rows, f"{prior.category}: {prior_file}"))
    if random_codes is not None:
        fills = (
            "" if random_codes.fills_box is None else f", as large as the box {random_codes.fills_box:.3f}"
        )
        console.print(
            f"of {random_codes.count} random codes {random_codes.failed} have no surface; "
            f"in one piece {random_codes.one_piece:.3f}{fills}"
        )
    for views, each in (guess or {}).items():
        console.print(
            f"first guess from {views} view{'s' * (views > 1)}: heading right {each.heading_right:.3f} "
            f"({each.heading_nll:.2f} nats), centre off {100 * each.centre_m:.1f} cm ({len(each.right)} objects)"
        )
    console.print(f"written to {command.json}", markup=False)
    return result


def _guess(
    command: EvaluatePriorCommand,
    prior: ShapePrior,
    meshes: ChosenMeshes,
    rows: Sequence[ShapeRow],
    report: Callable[[int, int], None],
) -> dict[int, GuessQuality] | None:
    """What the first guess is worth on the meshes that were fitted; None where there is none, or it cannot be measured."""
    fitted = [
        (path, name)
        for path, name, row in zip(meshes.paths, meshes.names, rows, strict=True)
        if row.chamfer is not None
    ]
    if prior.guess is None or not fitted:
        return None
    try:
        with TemporaryDirectory() as folder:
            return guess_quality(
                prior, fitted, command.config.seed, Path(folder), command.jobs, progress=report
            )
    except Exception as error:  # the rows are worth more, whatever it is
        log.debug("the first guess", exc_info=True)
        log.warning("the first guess is not measured: %s", error)
        return None


def _check(command: EvaluatePriorCommand) -> None:
    if command.heldout and command.all:
        raise EvaluationError("--heldout and --all exclude each other: give one of them")
    if command.jobs < 1 or command.random_codes < 0:
        raise EvaluationError("--jobs must be at least 1 and --random-codes at least 0")
    folder = command.json.absolute().parent
    while not folder.exists():
        folder = folder.parent
    if command.json.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise EvaluationError(f"{command.json} cannot be written: give a file in a folder that can be")
