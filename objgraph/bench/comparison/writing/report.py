"""What is written of any comparison: one JSON document, tables in Markdown, pictures, a page; the tables are also shown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from rich.console import Console

from objgraph.bench.comparison.running.store import Row, write_text
from objgraph.bench.comparison.writing.bootstrap import LEVEL, RESAMPLES
from objgraph.bench.comparison.writing.grid import Grid
from objgraph.bench.comparison.writing.page import PAGE, page_of
from objgraph.training.meshes.folder import write_json
from objgraph.version import program_version

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Report:
    """Figures, tables and pictures of some rows."""

    seed: int
    rows: Sequence[Row]
    entries: Sequence[Entry]
    pairs: Sequence[Entry]
    tables: Sequence[Grid]
    details: Mapping[str, Any]
    """What else made the figures."""
    independent: str
    """What the bootstrap draws."""
    measured: str
    """What the figures mean, for whoever reads the JSON alone."""
    pictures: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)
    """What draws each, by the file's name."""
    name: str = "tables.md"

    def document(self, command: str) -> dict[str, Any]:
        """Figures and all that made them; no date, so that equal runs give equal documents but for the times."""
        return {
            "command": command,
            "version": program_version(),
            "rows_made_by": sorted({row.version for row in self.rows}),
            "seed": self.seed,
            **self.details,
            "bootstrap": {"over": self.independent, "level": LEVEL, "resamples": RESAMPLES},
            "measured": self.measured,
            "rows": list(self.entries),
            "paired": list(self.pairs),
            "tables": [asdict(table) for table in self.tables],
        }

    def markdown(self, command: str) -> str:
        """All tables, and what made them."""
        head = f"Made by `{command}` (seed {self.seed}, version {program_version()}).\n"
        return "\n".join([head, *(table.markdown() for table in self.tables)])

    def publish(self, command: str, json: Path, folder: Path, console: Console) -> dict[str, Any]:
        """Write all and show the tables; gives the document, which raises EvaluationError where it cannot be written."""
        document = self.document(command)
        write_json(document, json)
        write_text(self.markdown(command), folder / self.name)
        for name, draw in self.pictures.items():
            draw(folder / name)
        about = (
            f"Made by <code>{escape(command)}</code> (seed {self.seed}, version {escape(program_version())})."
        )
        pictures = [folder / name for name in self.pictures]
        write_text(page_of(f"Comparison: {folder.name}", about, self.tables, pictures), folder / PAGE)
        for table in self.tables:
            console.print(table.rich())
        console.print(
            f"figures in {json}, tables, rows and plots in {folder}, {PAGE} shows them",
            markup=False,
            soft_wrap=True,
        )
        return document
