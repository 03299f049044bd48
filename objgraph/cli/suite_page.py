"""The pages of a suite: results.md, and one for each part, made of what the runs left."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from objgraph.bench.comparison.running.store import write_text
from objgraph.bench.comparison.writing.behind import FIGURES_OF_ROWS, behind_table
from objgraph.bench.comparison.writing.glance import glance_tables
from objgraph.bench.comparison.writing.grid import Grid
from objgraph.bench.comparison.writing.older import renamed
from objgraph.checked import check_fields, parse_json
from objgraph.cli.evaluate_command import FIGURES
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


def render(suite: Suite, folder: Path, to: Path) -> Path:
    """Write `results.md`, pictures and, in `results/`, a page for each part and the figures that it is made of.

    Of a part that is not in `folder` the pages show what `to` kept of it; one that was never run is named as such.

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
    titles = {part.title: found[part.name] for part in parts(suite) if part.name in found}
    grids = [*glance_tables(titles), behind_table(titles)]
    lines = ["# Results\n", _head(suite), *(grid.markdown(2) for grid in grids), "## Parts\n"]
    for part in parts(suite):
        if (document := found.get(part.name)) is None:
            lines.append(f"- {part.title}: not run.")
            continue
        pictures = [name for each in part.pictures if (images / (name := _picture(part, each))).is_file()]
        write_text(_page(part, document, pictures), kept / f"{part.name}.md")
        lines.append(f"- [{part.title}](results/{part.name}.md). {_made_by(document)}")
    write_text("\n".join([*lines, ""]), to / "results.md")
    return to / "results.md"


def _page(part: Part, document: Mapping[str, Any], pictures: Sequence[str]) -> str:
    lines = [f"# {part.title}\n", f"    {document['command']}\n\n{_made_by(document)}\n"]
    lines += [
        Grid.of(grid).markdown(2) for grid in document["tables"] if grid["title"].startswith(part.tables)
    ]
    return "\n".join([*lines, *(f"![{part.title}](../images/{name})\n" for name in pictures)])


def _picture(part: Part, name: str) -> str:
    return f"results_{part.name}_{name}"


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
        return renamed(document)
    except FileNotFoundError:
        return None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise EvaluationError(f"{path} is damaged ({error}): delete it and run the suite again") from error


def _head(suite: Suite) -> str:
    return (
        f"Made by `objgraph evaluate --suite {suite}` and its `--render`: no number here is typed by hand. [What the figures "
        "mean, what methods and starts are](guides/compare.md); [what is wrong with scans of each "
        "difficulty](reference/benchmark.md). Methods called the paper's (`ours`), DSP-SLAM's and NodeSLAM's are our own "
        "programs, written from the papers.\n"
    )


def _made_by(document: Mapping[str, Any]) -> str:
    priors = sorted((document.get("priors") or {}).items())
    hashes = ", ".join(f"{name} `{digest[:12]}`" for name, digest in priors)
    shipped = available_priors()
    older = [name for name, digest in priors if name in shipped and load_prior(name).digest != digest]
    since = f" Those of {' and '.join(older)} that ship now are others." if older else ""
    return f"Seed {document['seed']}, rows by {', '.join(document['rows_made_by'])}{'; priors: ' * bool(priors)}{hashes}.{since}"
