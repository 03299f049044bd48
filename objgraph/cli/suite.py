"""`objgraph evaluate --suite`: all that docs/results.md shows, and the page itself, made of what the runs left."""

import shlex
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from objgraph.bench.comparison.running.store import write_text
from objgraph.bench.comparison.writing.behind import FIGURES_OF_ROWS, behind_table
from objgraph.bench.comparison.writing.grid import Grid
from objgraph.checked import check_fields, parse_json
from objgraph.cli.evaluate_command import FIGURES, EvaluateCommand
from objgraph.cli.suite_parts import Part, Suite, parts
from objgraph.errors import EvaluationError
from objgraph.priors.registry import available_priors, load_prior
from objgraph.training.meshes.folder import write_json

_FIELDS = {
    "command": str,
    "seed": int,
    "rows_made_by": list[str],
    "priors": dict[str, str] | None,
    "rows": list[dict[str, Any]],
    "tables": list[dict[str, Any]],
}
"""Of a part's figures, those that the page shows."""
_FOLDERS = ("root", "meshes")
"""What settings call the folders that data are in."""
Run = Callable[[EvaluateCommand, Console, str], object]
"""What does one command; the last is how it would be typed."""


def run_suite(command: EvaluateCommand, console: Console, run: Run) -> None:
    """Run what is not done yet of a suite, and write its page; `run` does one command.

    Raises:
        EvaluationError: there is no folder for it, or a part fails.
    """
    assert command.suite is not None
    if command.out is None:
        raise EvaluationError("--suite needs a folder: --out")
    if command.render is None:
        for part in _chosen(command):
            own = _command(part, command)
            missing = [path for path in (own.root, own.meshes) if path is not None and not path.is_dir()]
            if missing:
                console.print(f"{part.name}: left out, there is no {missing[0]}", soft_wrap=True)
                continue
            console.rule(part.title)
            run(own, console, line_of(part, command))
    page = render(command.suite, command.out, command.render or command.out)
    console.print(f"the page is {page}", soft_wrap=True)


def _chosen(command: EvaluateCommand) -> list[Part]:
    assert command.suite is not None
    found = parts(command.suite)
    names = ",".join(command.parts).replace(",", " ").split()
    if unknown := set(names) - {part.name for part in found}:
        raise EvaluationError(
            f"--parts: no part {', '.join(sorted(unknown))} in the suite '{command.suite}'; there are "
            + ", ".join(part.name for part in found)
        )
    return [part for part in found if not names or part.name in names]


def line_of(part: Part, command: EvaluateCommand) -> str:
    """The command of one part, as it would be typed."""
    words = ["objgraph", "evaluate", "--seed", str(command.seed)]
    for name, value in _options(part, command):
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, tuple):
            words += [option, ",".join(value)]
        elif value is True:
            words.append(option)
        else:
            words += [option, f"DATA/{value}" if isinstance(value, Path) else str(value)]
    return shlex.join([*words, "--out", f"OUT/{part.name}"])


def render(suite: Suite, folder: Path, to: Path) -> Path:
    """Write `results.md`, its pictures and, in `results/`, the figures that it is made of.

    Of a part that is not in `folder` the page shows what `to` kept of it; one that was never run is named as such.

    Raises:
        EvaluationError: nothing was run, or a file is damaged or cannot be written.
    """
    kept, images = to / "results", to / "images"
    for part in parts(suite):
        if (document := _document(folder / part.name / FIGURES)) is None:
            continue
        for made in (kept, images):
            made.mkdir(parents=True, exist_ok=True)
        write_json(_without_place(document), kept / f"{part.name}.json")
        for name in part.pictures:
            if (folder / part.name / name).is_file():
                shutil.copyfile(folder / part.name / name, images / _picture(part, name))
    found = {
        part.name: document for part in parts(suite) if (document := _document(kept / f"{part.name}.json"))
    }
    if not found:
        raise EvaluationError(f"{folder}: nothing of the suite '{suite}' has been run there")
    lines = ["# Results\n", _head(suite, found)]
    lines += [
        behind_table({part.title: found[part.name] for part in parts(suite) if part.name in found}).markdown(
            2
        )
    ]
    for part in parts(suite):
        lines.append(f"## {part.title}\n")
        document = found.get(part.name)
        if document is None:
            lines.append("Not run.\n")
            continue
        lines.append(f"    {document['command']}\n\n{_made_by(document)}\n")
        for grid in document["tables"]:
            if grid["title"].startswith(part.tables):
                lines.append(Grid.of(grid).markdown())
        pictures = [_picture(part, name) for name in part.pictures]
        lines += [f"![{part.title}](images/{name})\n" for name in pictures if (images / name).is_file()]
    write_text("\n".join(lines), to / "results.md")
    return to / "results.md"


def _picture(part: Part, name: str) -> str:
    return f"results_{part.name}_{name}"


def _options(part: Part, command: EvaluateCommand) -> list[tuple[str, Any]]:
    """A part's, with no more objects than the suite is asked for."""
    options = dict(part.options)
    if command.objects is not None and "objects" in options:
        options["objects"] = min(options["objects"], command.objects)
    return [*options.items()]


def _command(part: Part, command: EvaluateCommand) -> EvaluateCommand:
    assert command.out is not None
    data = command.root or Path()
    options = {
        name: data / value if isinstance(value, Path) else value for name, value in _options(part, command)
    }
    out = command.out / part.name
    given: dict[str, Any] = {
        "suite": None,
        "parts": (),
        "root": None,
        "out": out,
        "json": out / FIGURES,
        **options,
    }
    return replace(command, **given)


def _without_place(document: Any, key: str = "") -> Any:
    """The figures with folders by their names alone: a page that is published says nothing of one machine."""
    if isinstance(document, dict):
        return {name: _without_place(value, name) for name, value in document.items()}
    return Path(document).name if key in _FOLDERS and isinstance(document, str) else document


def _document(path: Path) -> dict[str, Any] | None:
    try:
        document = parse_json(path.read_bytes())
        check_fields(document, _FIELDS)
        for row in document["rows"]:
            check_fields(row, FIGURES_OF_ROWS)
        for table in document["tables"]:
            Grid.of(table)
        return document
    except FileNotFoundError:
        return None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise EvaluationError(f"{path} is damaged ({error}): delete it and run the suite again") from error


def _head(suite: Suite, found: Mapping[str, Mapping[str, Any]]) -> str:
    versions = sorted({version for document in found.values() for version in document["rows_made_by"]})
    return (
        f"Made by `objgraph evaluate --suite {suite}` and its `--render`: no number here is typed by hand. "
        f"Program: {', '.join(versions)}; each part says its own, and its priors. [What the figures mean, what "
        "methods and starts are](guides/compare.md); [what is wrong with scans of each difficulty](reference/benchmark.md).\n"
    )


def _made_by(document: Mapping[str, Any]) -> str:
    priors = sorted((document.get("priors") or {}).items())
    hashes = ", ".join(f"{name} `{digest[:12]}`" for name, digest in priors)
    shipped = available_priors()
    older = [name for name, digest in priors if name in shipped and load_prior(name).digest != digest]
    since = f" Those of {' and '.join(older)} that ship now are others." if older else ""
    return f"Seed {document['seed']}, rows by {', '.join(document['rows_made_by'])}{'; priors: ' * bool(priors)}{hashes}.{since}"
