"""`objgraph evaluate --suite`: all that docs/results.md shows, and the page itself, made of what the runs left."""

import json
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console

from objgraph.bench.comparison.behind import behind_table
from objgraph.bench.comparison.grid import Grid
from objgraph.bench.comparison.store import write_text
from objgraph.errors import EvaluationError

if TYPE_CHECKING:
    from objgraph.cli.evaluate import EvaluateCommand

Suite = Literal["docs", "quick"]
FIGURES = "figures.json"
_SHARED = "start,graph,graph-bare,ours,dsp-slam,node-slam,dsp-slam-gn"
_OWN = "start@own,start-7dof@own,graph-bare@own,ours@own,dsp-slam@own,node-slam@own,dsp-slam-gn@own"
_EFFECTS = (
    "ours,ours-released,ours+code-weight,ours+clipping,ours+depth-variance,ours+band,ours+world-scale,"
    "ours+first-view-depths,ours-det2d,ours-det2d-released,ours-det2d+squared,dsp-slam-gn,dsp-slam-gn-released,"
    "dsp-slam-gn+damping,dsp-slam-gn+huber,dsp-slam-gn+iterations,dsp-slam-gn+7dof,dsp-slam-gn+one-view"
)
_RATES = ("Rates with", "Medians", "Table II")


@dataclass(frozen=True)
class Part:
    """One run of the suite."""

    name: str
    """Of its folder."""
    title: str
    options: Mapping[str, Any]
    """Of `EvaluateCommand`; paths are relative to the folder of data."""
    tables: tuple[str, ...] = _RATES
    """Beginnings of the titles of the tables that the page shows."""
    pictures: tuple[str, ...] = ()


def parts(suite: Suite) -> list[Part]:
    """What a suite runs, in its order."""
    return _docs() if suite == "docs" else _quick()


def _docs() -> list[Part]:
    def methods(shapes: str) -> tuple[str]:
        # what the paper's method makes of floor and gravity takes as long as itself: once is enough
        return (f"{_SHARED},{_OWN}{',ours-floor' * (shapes == 'families')}",)

    found = [
        Part(
            f"{difficulty}-{shapes}", f"{difficulty.capitalize()}: {words}",
            {"difficulty": difficulty, "objects": objects, "views": ("3",), "methods": methods(shapes), **_shapes(shapes)},
            pictures=("pose_over_faults.png", "error_against_uncertainty.png"),
        )
        for difficulty, objects in (("hard", 24), ("everyday", 8))
        for shapes, words in (
            ("families", "the benchmark's own families"),
            ("cad", "meshes made by people"),
            ("everyday", "meshes made by a generator"),
        )
    ]  # fmt: skip
    return [
        *found,
        Part(
            "views", "Everyday: one, two and three views",
            {"difficulty": "everyday", "objects": 12, "views": ("1,2,3",), "methods": ("start,graph,graph-bare,dsp-slam-gn",)},
            pictures=("error_against_views.png",),
        ),
        Part(
            "stability", "The same objects again",
            {"difficulty": "everyday", "objects": 6, "views": ("3",), "methods": ("start,graph,dsp-slam-gn",), "stability": True},
            ("The same",),
        ),
        Part(
            "released", "What the released programs do otherwise",
            {"difficulty": "everyday", "objects": 3, "views": ("3",), "methods": (_EFFECTS,)}, ("Rates with", "Medians"),
        ),
        Part(
            "scene0470", "A real scan: ScanNet scene0470_00",
            {
                "dataset": "scannet", "root": Path("scannet"), "scenes": ("scene0470_00",), "views": ("1,2,3",),
                "methods": (f"{_SHARED},{_OWN}",),
            },
        ),
        *_real("docs"),
    ]  # fmt: skip


def _quick() -> list[Part]:
    methods = {"views": ("3",), "methods": ("start,graph,graph-bare,dsp-slam-gn,start@own,dsp-slam-gn@own",)}
    return [
        Part("hard-families", "Hard: the benchmark's own families", {"difficulty": "hard", "objects": 5, **methods}),
        Part(
            "hard-everyday", "Hard: meshes made by a generator",
            {"difficulty": "hard", "objects": 3, **_shapes("everyday"), **methods},
        ),
        Part(
            "ours", "Everyday: the paper's method",
            {"difficulty": "everyday", "objects": 2, "views": ("3",), "methods": ("start@own,graph,ours,ours@own",)},
        ),
        *_real("quick"),
    ]  # fmt: skip


def _real(suite: Suite) -> list[Part]:
    """Real sensors, whose ground truth is boxes."""
    methods = (
        "graph,graph-bare,ours,dsp-slam,node-slam,dsp-slam-gn" if suite == "docs" else "graph,dsp-slam-gn"
    )
    views = ("1,2,3",) if suite == "docs" else ("3",)
    factors = (1.0, 2.0, 0.5) if suite == "docs" else (1.0,)
    cameras = [
        Part(
            name, f"A real sensor: {words}",
            {"dataset": name, "root": Path(folder), "methods": (methods,), "views": views}, ("Boxes",),
        )
        for name, folder, words in (
            ("sevenscenes", "sevenscenes", "7-Scenes redkitchen"),
            ("icl", "icl_livingroom1", "ICL living room"),
        )
    ]  # fmt: skip
    return cameras + [
        Part(
            f"kitti-{factor:g}", f"LiDAR: KITTI, a detector of {factor:g} times the noise that the graph is told",
            {
                "dataset": "kitti", "root": Path("kitti"), "detector_noise": factor,
                "methods": (methods if factor == 1 else "graph,dsp-slam-gn",),
            },
            ("Table III:",),
        )
        for factor in factors
    ]  # fmt: skip


def _shapes(shapes: str) -> dict[str, Any]:
    return {} if shapes == "families" else {"shapes": shapes, "meshes": Path("cad2")}


def run_suite(command: "EvaluateCommand", console: Console, run: Any) -> None:
    """Run what is not done yet of a suite, and write its page; `run` does one command.

    Raises:
        EvaluationError: there is no folder for it, or a part fails.
    """
    assert command.suite is not None
    if command.out is None:
        raise EvaluationError("--suite needs a folder: --out")
    if command.render is None:
        for part in parts(command.suite):
            own = _command(part, command)
            missing = [path for path in (own.root, own.meshes) if path is not None and not path.is_dir()]
            if missing:
                console.print(f"{part.name}: left out, there is no {missing[0]}", soft_wrap=True)
                continue
            console.rule(part.title)
            run(own, console, line_of(part, command))
    page = render(command.suite, command.out, command.render or command.out)
    console.print(f"the page is {page}", soft_wrap=True)


def line_of(part: Part, command: "EvaluateCommand") -> str:
    """The command of one part, as it would be typed."""
    words = ["objgraph", "evaluate", "--seed", str(command.seed)]
    for name, value in part.options.items():
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, tuple):
            words += [option, ",".join(value)]
        elif value is True:
            words.append(option)
        else:
            words += [option, f"DATA/{value}" if isinstance(value, Path) else str(value)]
    return shlex.join([*words, "--out", f"OUT/{part.name}"])


def render(suite: Suite, folder: Path, to: Path) -> Path:
    """Write `results.md` and its pictures from the runs' JSON; parts that were not run are named as such.

    Raises:
        EvaluationError: nothing was run, or a file is damaged or cannot be written.
    """
    found = {part.name: document for part in parts(suite) if (document := _document(folder / part.name))}
    if not found:
        raise EvaluationError(f"{folder}: nothing of the suite '{suite}' has been run there")
    lines = ["# Results\n", _head(suite, found)]
    lines += [
        behind_table({part.title: found[part.name] for part in parts(suite) if part.name in found}).markdown()
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
        for name in part.pictures:
            if (folder / part.name / name).is_file():
                picture = f"results_{part.name}_{name}"
                (to / "images").mkdir(parents=True, exist_ok=True)
                shutil.copyfile(folder / part.name / name, to / "images" / picture)
                lines.append(f"![{part.title}](images/{picture})\n")
    to.mkdir(parents=True, exist_ok=True)
    write_text("\n".join(lines), to / "results.md")
    return to / "results.md"


def _command(part: Part, command: "EvaluateCommand") -> "EvaluateCommand":
    assert command.out is not None
    data = command.root or Path()
    options = {
        name: data / value if isinstance(value, Path) else value for name, value in part.options.items()
    }
    out = command.out / part.name
    if command.objects is not None and "objects" in options:
        options["objects"] = min(options["objects"], command.objects)
    given: dict[str, Any] = {"suite": None, "root": None, "out": out, "json": out / FIGURES, **options}
    return replace(command, **given)


def _document(folder: Path) -> dict[str, Any] | None:
    try:
        return json.loads((folder / FIGURES).read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise EvaluationError(
            f"{folder / FIGURES} is damaged ({error}): delete it and run the suite again"
        ) from error


def _head(suite: Suite, found: Mapping[str, Mapping[str, Any]]) -> str:
    versions = sorted({version for document in found.values() for version in document["rows_made_by"]})
    priors: dict[str, str] = {}
    for document in found.values():
        priors |= document.get("priors", {})
    hashes = ", ".join(f"{name} `{digest[:12]}`" for name, digest in sorted(priors.items()))
    return (
        f"Made by `objgraph evaluate --suite {suite}` and its `--render`: no number here is typed by hand. "
        f"Program: {', '.join(versions)}. Priors: {hashes}. What the figures mean, what methods and starts are, and what "
        "is wrong with scans of each difficulty: [evaluation.md](evaluation.md).\n"
    )


def _made_by(document: Mapping[str, Any]) -> str:
    return f"Seed {document['seed']}, rows by {', '.join(document['rows_made_by'])}."
