"""`objgraph evaluate --suite`: all that docs/results.md shows, and the page itself, made of what the runs left."""

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from objgraph.cli.evaluate_command import FIGURES, EvaluateCommand
from objgraph.cli.suite_page import render
from objgraph.cli.suite_parts import Part, parts
from objgraph.errors import EvaluationError

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
                console.print(
                    f"{part.name}: left out, there is no {missing[0]}", markup=False, soft_wrap=True
                )
                continue
            console.rule(part.title)
            run(own, console, line_of(part, command))
    page = render(command.suite, command.out, command.render or command.out)
    console.print(f"the page is {page}", markup=False, soft_wrap=True)


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
