"""Which shape priors there are: `objgraph priors`."""

import json
import logging
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_type_hints

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from objgraph.atomic import write_file
from objgraph.checked import check_fields
from objgraph.errors import PriorError
from objgraph.priors.categories import LABELS
from objgraph.priors.registry import WEIGHTS
from objgraph.priors.shape_prior import ShapePrior
from objgraph.priors.store import load_prior_file

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PriorsCommand:
    """List the shape priors that ship with the library, and those given."""

    paths: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Further .safetensors files, or folders of them."""
    json: Path | None = None
    """Write the list here, too."""


@dataclass(frozen=True)
class PriorEntry:
    """What the list tells of a prior; None where its card does not say."""

    category: str
    file: str
    shipped: bool
    aliases: tuple[str, ...]
    """Labels that mean this category."""
    code_length: int
    network: str
    parameters: int
    training_shapes: int | None
    heldout_shapes: int | None
    heldout_chamfer: float | None
    """Median over held-out collected shapes, in box diagonals."""
    residual_sigma: float
    """Standard deviation of the SDF error near unseen surfaces, in box diagonals."""
    size_mean: float
    """Typical box diagonal, metres."""
    size_log_sigma: float
    first_guess: bool
    """Whether it proposes how an object may stand."""
    heading_right: float | None
    """Share of held-out objects whose likeliest heading is right, from most views."""
    licences: tuple[str, ...]
    bytes: int
    sha256: str


def priors_command(command: PriorsCommand, console: Console) -> list[PriorEntry]:
    """Print the list and, if asked, write it.

    Raises:
        PriorError: a given file is no prior, a given folder is missing, or the list cannot be written.
    """
    entries = list_priors(command.paths)
    console.print(priors_table(entries))
    if command.json is not None:
        _write(command.json, entries)
        console.print(f"written to {command.json}", markup=False)
    return entries


def list_priors(paths: Sequence[Path] = ()) -> list[PriorEntry]:
    """The shipped priors, then the given files and those in the given folders.

    In a folder, a file that is no prior is left out with a warning.

    Raises:
        PriorError: a given file is no prior, or a given folder is missing.
    """
    entries = [describe(path, shipped=True) for path in sorted(WEIGHTS.glob("*.safetensors"))]
    for path in paths:
        if not os.path.isdir(path):  # unlike Path's it bears a name that no file system takes
            entries.append(describe(path))
            continue
        for file in sorted(path.glob("*.safetensors")):
            try:
                entries.append(describe(file))
            except PriorError as error:
                log.warning("left out: %s", error)
    return entries


def describe(path: Path, shipped: bool = False) -> PriorEntry:
    """A file's entry; raises PriorError, naming it, where it is no prior."""
    prior = load_prior_file(path)
    try:
        entry = _entry(prior, path, shipped)
        check_fields(vars(entry), get_type_hints(PriorEntry))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise PriorError(f"{path}: its card is damaged ({error}); get the file anew") from error
    return entry


def _entry(prior: ShapePrior, path: Path, shipped: bool) -> PriorEntry:
    data, heldout = (prior.card.get(key) or {} for key in ("data", "heldout"))
    summary = heldout.get("summary") or {}
    return PriorEntry(
        category=prior.category,
        file=str(path),
        shipped=shipped,
        aliases=LABELS.get(prior.category, ()) if shipped else (),
        code_length=prior.decoder.code_length,
        network=_network(prior),
        parameters=sum(value.numel() for value in prior.decoder.parameters()),
        training_shapes=data.get("training_shapes"),
        heldout_shapes=summary.get("count"),
        heldout_chamfer=summary.get("chamfer_median"),
        residual_sigma=prior.residual_sigma,
        size_mean=prior.size_mean,
        size_log_sigma=prior.size_log_sigma,
        first_guess=prior.guess is not None,
        heading_right=_heading_right(prior),
        licences=tuple(data.get("licences") or ()),
        bytes=path.stat().st_size,
        sha256=prior.card["sha256"],
    )


def priors_table(entries: Iterable[PriorEntry]) -> Table:
    """One row a prior, its file and aliases below."""
    table = Table(title="Shape priors", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    longest = max((len(entry.category) for entry in entries), default=0)
    table.add_column("category", no_wrap=True, min_width=longest)
    table.add_column("network", no_wrap=True)
    labels = (
        "code",
        "trained\non",
        "held-out\nChamfer",
        "residual\nσ",
        "diagonal\nm",
        "heading\nright",
        "licences",
        "MB",
    )
    for label in labels:
        table.add_column(label, justify="right", no_wrap=True)
    table.add_column("also called, file")
    for entry in entries:
        place = [", ".join(entry.aliases)] if entry.aliases else []
        place += [] if entry.shipped else [entry.file]
        table.add_row(
            escape(entry.category),
            entry.network,
            str(entry.code_length),
            _or_dash(entry.training_shapes, "d"),
            _or_dash(entry.heldout_chamfer, ".4f"),
            f"{entry.residual_sigma:.4f}",
            f"{entry.size_mean:.2f}",
            "?"
            if entry.first_guess and entry.heading_right is None
            else _or_dash(entry.heading_right, ".2f"),
            str(len(entry.licences)) if entry.licences else "-",
            f"{entry.bytes / 1e6:.1f}",
            escape("\n".join(place)),
        )
    return table


def _heading_right(prior: ShapePrior) -> float | None:
    heldout = (prior.card.get("first_guess") or {}).get("heldout") or {}
    return heldout[max(heldout)]["heading_right"] if heldout and prior.guess is not None else None


def _network(prior: ShapePrior) -> str:
    """The decoder's kind and layers, as 5x256 or 512-512-253-512."""
    config = prior.decoder.config
    if hasattr(config, "width"):
        return f"{config.depth}x{config.width} {config.activation}"
    if hasattr(config, "dims"):
        widths = sorted(set(config.dims))
        return f"DeepSDF {len(config.dims)}x{'/'.join(map(str, widths))}"
    return type(prior.decoder).__name__.lower()


def _or_dash(value: float | int | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _write(path: Path, entries: list[PriorEntry]) -> None:
    document = json.dumps({"priors": [asdict(entry) for entry in entries]}, indent=2) + "\n"
    write_file(path, document.encode(), PriorError)
