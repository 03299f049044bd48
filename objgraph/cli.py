"""The command `objgraph`."""

import logging
import os
import sys

import tyro
from rich.console import Console
from rich.logging import RichHandler

from objgraph.errors import ObjectGraphError


def main(arguments: list[str] | None = None) -> int:
    """Run one subcommand; an error that the user can mend is one line, not a traceback."""
    from objgraph.commands import MapCommand, run_map
    from objgraph.prior.commands import TrainCommand, run_train

    console = Console(width=None if sys.stdout.isatty() else int(os.environ.get("COLUMNS", "140")))
    logging.basicConfig(
        level=logging.WARNING, format="%(message)s", handlers=[RichHandler(console=console, show_path=False)]
    )

    def map_(command: tyro.conf.OmitArgPrefixes[MapCommand]) -> None:
        run_map(command, console)

    def train(command: tyro.conf.OmitArgPrefixes[TrainCommand]) -> None:
        run_train(command, console)

    try:
        tyro.extras.subcommand_cli_from_dict(
            {"map": map_, "train": train},
            prog="objgraph",
            description="Object-level mapping with learnt shape priors, as a factor graph.",
            args=arguments,
        )
    except ObjectGraphError as error:
        console.print(f"[bold red]error:[/] {error}", highlight=False)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
