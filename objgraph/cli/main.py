"""The command `objgraph`."""

import logging
import os
import shlex
import sys
from typing import Annotated

import tyro
from rich.console import Console
from rich.logging import RichHandler
from rich.markup import escape

from objgraph.errors import ObjectGraphError


def main(arguments: list[str] | None = None) -> int:
    """Run one subcommand; an error that the user can mend is one line, not a traceback."""
    # imported here, so that a mistyped word is answered before torch and open3d are loaded
    from objgraph.cli.evaluate import EvaluateCommand, run_evaluate
    from objgraph.cli.evaluate_prior import EvaluatePriorCommand, run_evaluate_prior
    from objgraph.cli.map import MapCommand, run_map
    from objgraph.cli.next_view import NextViewCommand, run_next_view
    from objgraph.cli.priors import PriorsCommand, priors_command
    from objgraph.cli.segment import SegmentCommand, run_segment
    from objgraph.training.convert import ConvertConfig, convert_command
    from objgraph.training.export import train_command
    from objgraph.training.train import TrainConfig

    console = Console(width=None if sys.stdout.isatty() else int(os.environ.get("COLUMNS", "140")))
    logging.basicConfig(
        level=logging.WARNING, format="%(message)s", handlers=[RichHandler(console=console, show_path=False)]
    )

    def map_(command: Annotated[MapCommand, tyro.conf.arg(name="")]) -> None:
        """Map the objects of one scan."""
        run_map(command, console)

    def train(config: Annotated[TrainConfig, tyro.conf.arg(name="")]) -> None:
        """Train a category's shape prior; a killed run goes on where it was."""
        console.print(f"written to {train_command(config)}")

    def evaluate(
        command: Annotated[EvaluateCommand, tyro.conf.arg(name=""), tyro.conf.FlagCreatePairsOff],
    ) -> None:
        """Compare methods on objects with ground truth: the paper's tables, intervals, plots."""
        typed = sys.argv[1:] if arguments is None else arguments
        run_evaluate(command, console, shlex.join(["objgraph", *typed]))

    def evaluate_prior(
        command: Annotated[EvaluatePriorCommand, tyro.conf.arg(name=""), tyro.conf.FlagCreatePairsOff],
    ) -> None:
        """Measure a shape prior on a folder of meshes: the best code of each, given all of it and given one view."""
        run_evaluate_prior(command, console)

    def next_view(command: Annotated[NextViewCommand, tyro.conf.arg(name="")]) -> None:
        """Say from where to look next at a saved map's objects, and what that is expected to tell."""
        run_next_view(command, console)

    def segment(command: Annotated[SegmentCommand, tyro.conf.arg(name="")]) -> None:
        """Segment the colour images of a data set that has no masks yet, with Mask2Former."""
        run_segment(command, console)

    def convert_prior(config: Annotated[ConvertConfig, tyro.conf.arg(name="")]) -> None:
        """Make a prior of a DeepSDF experiment folder (specs.json and ModelParameters)."""
        console.print(f"written to {convert_command(config)}")

    def priors(command: Annotated[PriorsCommand, tyro.conf.arg(name="")]) -> None:
        """List the shape priors that there are, and what is known of them."""
        priors_command(command, console)

    try:
        tyro.extras.subcommand_cli_from_dict(
            {
                "map": map_,
                "next-view": next_view,
                "evaluate": evaluate,
                "train": train,
                "convert-prior": convert_prior,
                "priors": priors,
                "evaluate-prior": evaluate_prior,
                "segment": segment,
            },
            prog="objgraph",
            description="Object-level mapping with learnt shape priors, as a factor graph.",
            args=arguments,
        )
    except ObjectGraphError as error:
        console.print(f"[bold red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
