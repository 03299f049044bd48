"""The command `objgraph`: one verb, whose libraries alone are loaded."""

import inspect
import io
import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

Command = TypeVar("Command")


def _map(arguments: list[str], console: "Console") -> None:
    """Map the objects of one scan, or with --scenes of many.

    $ objgraph map --dataset sample --out out/demo
    $ objgraph map --dataset folder --root MYSCAN --out out/mine
    $ objgraph map --dataset scannet --root DIR --scene scene0470_00 --categories chair table --out out/chairs
    $ objgraph map --dataset scannet --root DIR --scenes all --jobs 2 --out out/maps
    """
    from objgraph.cli.map import MapCommand, run_map
    from objgraph.cli.map_scenes import run_map_scenes

    command = _parsed(MapCommand, "map", arguments)
    (run_map if command.scenes is None else run_map_scenes)(command, console)


def _report(arguments: list[str], console: "Console") -> None:
    """Write a saved map's page: one HTML file with the map in 3D, its table and the objects' views.

    $ objgraph report out/demo
    """
    from objgraph.cli.report import ReportCommand, run_report

    run_report(_parsed(ReportCommand, "report", arguments), console)


def _view(arguments: list[str], console: "Console") -> None:
    """Show a saved map in the viewer rerun, with its scan's frames; without a screen, write a file for it.

    $ objgraph view out/demo
    $ objgraph view out/demo --save demo.rrd
    """
    from objgraph.cli.view import ViewCommand, run_view

    run_view(_parsed(ViewCommand, "view", arguments), console)


def _next_view(arguments: list[str], console: "Console") -> None:
    """Say from where to look next at a saved map's objects, and what that is expected to tell.

    $ objgraph next-view out/demo --out out/next
    $ objgraph next-view out/demo --cameras reachable.txt --out out/next
    """
    from objgraph.cli.next_view import NextViewCommand, run_next_view

    run_next_view(_parsed(NextViewCommand, "next-view", arguments), console)


def _evaluate(arguments: list[str], console: "Console") -> None:
    """Compare methods on objects with ground truth: the paper's tables, intervals, plots.

    $ objgraph evaluate --difficulty hard --methods graph,ours --views 3 --seed 5 --out out/hard --jobs 2
    $ objgraph evaluate --suite quick --root DATA --seed 5 --out out/quick --jobs 2
    """
    import shlex

    from objgraph.cli.evaluate import run_evaluate
    from objgraph.cli.evaluate_command import EvaluateCommand

    command = _parsed(EvaluateCommand, "evaluate", arguments)
    run_evaluate(command, console, shlex.join(["objgraph", "evaluate", *arguments]))


def _calibrate(arguments: list[str], console: "Console") -> None:
    """Learn from objects with ground truth how far maps are to be trusted: verdicts, and sets that hold what they say.

    $ objgraph calibrate out/hard out/everyday --out out/calibration.json
    """
    from objgraph.cli.calibrate import CalibrateCommand, run_calibrate

    run_calibrate(_parsed(CalibrateCommand, "calibrate", arguments), console)


def _train(arguments: list[str], console: "Console") -> None:
    """Train a category's shape prior; a killed run goes on where it was.

    $ objgraph train --category sofa --meshes MESHES --out out/sofa --bf16 0.9
    """
    from objgraph.training.decoder.train import TrainConfig
    from objgraph.training.export import train_command

    console.print(f"written to {train_command(_parsed(TrainConfig, 'train', arguments))}", markup=False)


def _train_guess(arguments: list[str], console: "Console") -> None:
    """Give a prior that has none a first guess: a network that proposes how an object may stand.

    $ objgraph train-guess --prior sofa.safetensors --out sofa-with-guess.safetensors
    """
    from objgraph.training.guess.command import GuessCommand, guess_command

    console.print(
        f"written to {guess_command(_parsed(GuessCommand, 'train-guess', arguments))}", markup=False
    )


def _convert_prior(arguments: list[str], console: "Console") -> None:
    """Make a prior of a DeepSDF experiment folder (specs.json and ModelParameters).

    $ objgraph convert-prior --source EXPERIMENT --category sofa --out sofa.safetensors
    """
    from objgraph.training.convert import ConvertConfig, convert_command

    console.print(
        f"written to {convert_command(_parsed(ConvertConfig, 'convert-prior', arguments))}", markup=False
    )


def _priors(arguments: list[str], console: "Console") -> None:
    """List the shape priors that there are, and what is known of them.

    $ objgraph priors
    $ objgraph priors sofa.safetensors --json priors.json
    """
    from objgraph.cli.priors import PriorsCommand, priors_command

    priors_command(_parsed(PriorsCommand, "priors", arguments), console)


def _evaluate_prior(arguments: list[str], console: "Console") -> None:
    """Measure a shape prior on folders of meshes: the best code of each, given all of it and given one view.

    $ objgraph evaluate-prior --category chair --meshes MESHES --json chair.json
    """
    from objgraph.cli.evaluate_prior import EvaluatePriorCommand, run_evaluate_prior

    run_evaluate_prior(_parsed(EvaluatePriorCommand, "evaluate-prior", arguments), console)


def _doctor(arguments: list[str], console: "Console") -> int:
    """Say what is installed and, with --root, what was understood of the data and what is wrong with them.

    $ objgraph doctor
    $ objgraph doctor --dataset folder --root MYSCAN --out out/doctor
    """
    from objgraph.cli.doctor import DoctorCommand, run_doctor

    return run_doctor(_parsed(DoctorCommand, "doctor", arguments), console)


def _sensor(arguments: list[str], console: "Console") -> None:
    """Measure a scan's depth noise and how accurate its camera poses are, and write settings for `map --config`.

    $ objgraph sensor --dataset folder --root MYSCAN --out sensor.json
    """
    from objgraph.cli.sensor import SensorCommand, run_sensor

    run_sensor(_parsed(SensorCommand, "sensor", arguments), console)


def _segment(arguments: list[str], console: "Console") -> None:
    """Segment the colour images of a data set that has no masks yet, with Mask2Former.

    $ objgraph segment --root MYSCAN --up 0 0 1
    """
    from objgraph.cli.segment import SegmentCommand, run_segment

    run_segment(_parsed(SegmentCommand, "segment", arguments), console)


def _bench(arguments: list[str], console: "Console") -> None:
    """Measure how fast the program is on this machine.

    $ objgraph bench --json out/bench.json
    $ objgraph bench --parts floor cores
    """
    from objgraph.cli.bench import BenchCommand, run_bench

    run_bench(_parsed(BenchCommand, "bench", arguments), console)


VERBS: dict[str, Callable[[list[str], "Console"], int | None]] = {
    "map": _map,
    "report": _report,
    "view": _view,
    "next-view": _next_view,
    "evaluate": _evaluate,
    "calibrate": _calibrate,
    "train": _train,
    "train-guess": _train_guess,
    "convert-prior": _convert_prior,
    "priors": _priors,
    "evaluate-prior": _evaluate_prior,
    "segment": _segment,
    "doctor": _doctor,
    "sensor": _sensor,
    "bench": _bench,
}
"""Each gives the exit status; None is success."""


_GOES_ON = ("evaluate", "train", "train-guess")
"""Verbs that keep what they have finished; `map` does with --scenes."""


def main(arguments: list[str] | None = None) -> int:
    """Run one verb; an error that the user can mend is one line, not a traceback.

    Returns:
        The exit code: 0, 1 after an error that is told, 130 where the user stopped it.

    Raises:
        SystemExit: help or the version was asked for (0), or the words are none of the command's (2).
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        # of a letter that the terminal's encoding lacks the code is printed, as on stderr
        sys.stdout.reconfigure(errors="backslashreplace")
    verb, *rest = (sys.argv[1:] if arguments is None else arguments) or [""]
    loudness = {"-q": -1, "--quiet": -1, "-v": 1, "--verbose": 1}.get(verb, 0)
    if loudness:
        verb, *rest = rest or [""]
    if verb in ("-h", "--help"):
        print(_help())
        raise SystemExit(0)
    if verb == "--version":
        from objgraph.version import program_version

        print(f"objgraph {program_version()}")
        raise SystemExit(0)
    if verb not in VERBS:
        problem = f"no verb '{verb}'" if verb else "no verb given"
        print(f"objgraph: {problem}; there are {', '.join(VERBS)}", file=sys.stderr)
        raise SystemExit(2)
    return _run(verb, rest, loudness)


def _run(verb: str, arguments: list[str], loudness: int) -> int:
    import errno
    import logging
    import os

    from rich.console import Console
    from rich.logging import RichHandler
    from rich.markup import escape

    from objgraph.errors import ObjectGraphError
    from objgraph.work import keep_memory

    keep_memory()
    columns = os.environ.get("COLUMNS", "")
    given = int(columns) if columns.isdecimal() else 0
    width = None if sys.stdout.isatty() else given or 140
    console, errors = Console(width=width, quiet=loudness < 0), Console(width=width, stderr=True)
    logging.basicConfig(
        level={-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}[loudness],
        format="%(message)s",
        handlers=[RichHandler(console=errors, show_path=False)],
    )
    try:
        return VERBS[verb](arguments, console) or 0
    except ObjectGraphError as error:
        errors.print(f"[bold red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return 1
    except OSError as error:  # any word that is a path: too long, of a folder that is another's, on a disk that is read-only
        if error.filename is None:
            raise
        cure = ": give a shorter path" if error.errno == errno.ENAMETOOLONG else ""
        errors.print(f"error: {escape(str(error))}{cure}", highlight=False, soft_wrap=True)
        return 1
    except KeyboardInterrupt:
        goes_on = verb in _GOES_ON or any(word.startswith("--scenes") for word in arguments)
        kept = "the same command goes on from here" if goes_on else "nothing is half-written"
        errors.print(f"stopped; {kept}", highlight=False)
        return 130


def _parsed(kind: type[Command], verb: str, arguments: list[str]) -> Command:
    """The verb's words; `--help` shows what is usually turned, `--help-all` the groups of settings too."""
    import contextlib

    import tyro

    every = "--help-all" in arguments
    usual = not every and not {"-h", "--help"}.isdisjoint(arguments)
    shown = io.StringIO()
    try:
        with contextlib.redirect_stdout(shown) if usual else contextlib.nullcontext():
            return tyro.cli(
                kind,
                prog=f"objgraph {verb}",
                description=inspect.getdoc(VERBS[verb]),
                args=["--help"] if every else arguments,
                config=(tyro.conf.FlagCreatePairsOff,) if verb.startswith("evaluate") else (),
            )
    finally:
        if usual:
            print(_usual(verb, shown.getvalue()), end="")


def _usual(verb: str, text: str) -> str:
    """A help without its groups of settings, which are named."""
    group = r"^ (\S+) options +\n -+ *\n.*?\n +\n"
    if groups := re.findall(group, text, flags=re.DOTALL | re.MULTILINE):
        named = f"Further settings, by `objgraph {verb} --help-all`: {', '.join(groups)}.\n"
        return re.sub(group, "", text, flags=re.DOTALL | re.MULTILINE) + named
    return text


def summary(verb: str) -> str:
    """What a verb does, in a line; the examples of its help come after it."""
    return (VERBS[verb].__doc__ or "").splitlines()[0]


def _help() -> str:
    verbs = "\n".join(f"  {verb:<15} {summary(verb)}" for verb in VERBS)
    return (
        "usage: objgraph [-h] [--version] [-q | -v] VERB ...\n\n"
        "Object-level mapping with learnt shape priors, as a factor graph.\n\n"
        f"verbs (objgraph VERB --help says more, --help-all all):\n{verbs}\n\n"
        "-q says errors alone, -v what is decided on the way. A shell completes words after\n"
        "objgraph VERB --tyro-print-completion bash (or zsh, tcsh).\n"
        "exit codes: 0, 1 after an error that is told, 2 for words that are none of the command's, 130 when stopped."
    )


if __name__ == "__main__":
    sys.exit(main())
