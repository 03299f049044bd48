"""What the command line does to measure its own speed: `objgraph bench`."""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from objgraph.atomic import write_file
from objgraph.bench.speed.against import against_others
from objgraph.bench.speed.figure import Figure
from objgraph.bench.speed.floor import over_floor
from objgraph.bench.speed.many import many_objects
from objgraph.bench.speed.updates import growing_map
from objgraph.bench.speed.whole import two_cores, whole_commands
from objgraph.cli.progress import progress
from objgraph.cli.run_config import SAMPLE_ROOT
from objgraph.doctor.machine import processor
from objgraph.errors import EvaluationError, ObjectGraphError, ProcessError
from objgraph.version import program_version
from objgraph.work import Workers, spread


@dataclass(frozen=True)
class BenchCommand:
    """Measure how fast the program is on this machine: ratios of what is run in turns, which need a quiet machine."""

    json: Path | None = None
    """File for the figures."""
    parts: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME [NAME ...]]")] = ()
    """These alone: against (other methods), floor (of a linearisation), many (objects), updates (of a growing map), cores,
    whole (commands). By default all, half an hour."""
    seed: int = 0
    """Of the objects that methods are compared on."""
    objects: int = 4
    """Of those, chairs and tables each."""
    many: int = 1000
    """Objects of a large map; the small one has ten."""
    repeats: int = 5
    """Of what is measured in turns."""


def run_bench(command: BenchCommand, console: Console) -> dict[str, Figure]:
    """Measure, show and write; raises EvaluationError, at the end, where something could not be measured."""
    if command.repeats < 1 or command.objects < 1 or command.many < 20:
        raise EvaluationError("--repeats and --objects must be at least 1, --many at least 20")
    with tempfile.TemporaryDirectory() as folder, progress(console) as tell:
        measured = _parts(command, Path(folder))
        if unknown := sorted(set(command.parts) - set(measured)):
            raise EvaluationError(f"--parts: no part {', '.join(unknown)}; there are {', '.join(measured)}")
        chosen = [name for name in measured if not command.parts or name in command.parts]
        found: list[Figure] = []
        failed: list[str] = []
        for k, name in enumerate(chosen):
            tell(f"measuring {name}", k, len(chosen))
            try:
                found += measured[name]()
            except ObjectGraphError as error:
                failed.append(f"{name}: {error}")
        tell("measured", len(chosen), len(chosen))
    console.print(_table(found))
    if command.json is not None:
        document = {
            "objgraph": program_version(),
            "processor": processor(),
            "seed": command.seed,
            **{each.name: each.value for each in found},
            "figures": [asdict(each) for each in found],
        }
        write_file(command.json, (json.dumps(document, indent=1) + "\n").encode(), EvaluationError)
    if failed:
        raise EvaluationError("; ".join(failed))
    return {each.name: each for each in found}


def _parts(command: BenchCommand, folder: Path) -> dict[str, Callable[[], Sequence[Figure]]]:
    repeats = command.repeats
    return {
        "floor": lambda: [over_floor(SAMPLE_ROOT, 5 * repeats)],
        "against": lambda: against_others(folder / "against", command.seed, command.objects),
        "whole": lambda: whole_commands(SAMPLE_ROOT, repeats),
        "cores": lambda: [two_cores(folder, repeats)],
        "updates": lambda: [growing_map(10, command.many, 4 * repeats)],
        "many": lambda: _apart(partial(many_objects, 10, command.many)),
    }


def _apart(work: Callable[[], Sequence[Figure]]) -> Sequence[Figure]:
    """Done in a process of its own: memory that was taken before would hide what this takes."""
    ((_, found),) = spread([work], Workers(2))
    if isinstance(found, ProcessError):
        raise found
    return found


def _table(found: Sequence[Figure]) -> Table:
    table = Table(title="Speed", caption="spread: the least and the most of the repeats")
    table.add_column("figure", overflow="fold")
    for name in ("value", "spread", "aim"):
        table.add_column(name, justify="right")
    table.add_column("")
    table.add_column("of what", overflow="fold")
    for each in found:
        aim = "" if each.aim is None else f"{'<=' if each.better == 'less' else '>='} {each.aim:g}"
        word = {True: "reached", False: "missed", None: ""}[each.reached]
        spread = f"{each.low:.3g} to {each.high:.3g}"
        table.add_row(each.name, f"{each.value:.3g}", spread, aim, word, each.what)
    return table
