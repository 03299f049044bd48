"""A table of text before it is drawn: on the terminal or in Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from rich.markup import escape
from rich.table import Table
from rich.text import Text

from objgraph.checked import typed

NONE = "-"
_INFINITE = "∞"


@dataclass(frozen=True)
class Cell:
    """One entry."""

    text: str
    value: float | None = None
    """What it is ranked by, if it is."""
    rank: int = 0
    """1 for the best, 2 for the second; 0 otherwise."""
    faint: bool = False
    """Whether it stands in the background on the terminal."""


@dataclass(frozen=True)
class Grid:
    """Rows in sections under a header."""

    title: str
    header: tuple[str, ...]
    """A line break parts what stands above from what stands below."""
    sections: tuple[tuple[tuple[Cell, ...], ...], ...]
    caption: str = ""
    words: int = 1
    """How many of the first columns are text, not numbers."""

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Self:
        """From its JSON (`dataclasses.asdict`); raises TypeError or KeyError where it is none."""
        sections = tuple(
            tuple(tuple(typed(Cell, cell) for cell in row) for row in section) for section in data["sections"]
        )
        known = {"header": tuple(data["header"]), "sections": sections}
        return typed(cls, {**data, **known})

    def rich(self) -> Table:
        """For the terminal."""
        table = Table(title=escape(self.title), caption=Text(self.caption), caption_justify="left")
        for i, name in enumerate(self.header):
            table.add_column(
                escape(name), justify="left" if i < self.words else "right", no_wrap=i < self.words
            )
        for section in self.sections:
            for row in section:
                table.add_row(*(_rich(cell) for cell in row))
            table.add_section()
        return table

    def markdown(self, level: int = 3) -> str:
        """A heading of that level, the table, and the caption."""
        rows = [_line([name.replace("\n", " ") for name in self.header])]
        rows.append(_line(["---" if i < self.words else "---:" for i in range(len(self.header))]))
        rows += [_line([_markdown(cell) for cell in row]) for section in self.sections for row in section]
        caption = f"\n{self.caption}\n" if self.caption else ""
        return f"{level * '#'} {self.title}\n\n" + "\n".join(rows) + "\n" + caption


def ranged(
    entry: Mapping[str, Any], name: str, factor: float, digits: int, end_digits: int | None = None
) -> str:
    """A figure and its interval, in which what is not there is infinite."""
    ends = entry[f"{name}_interval"]
    if ends is None:
        return _scaled(entry[name], factor, digits, NONE)
    low, high = (_scaled(end, factor, end_digits or digits, _INFINITE) for end in ends)
    return f"{_scaled(entry[name], factor, digits, _INFINITE)} [{low}, {high}]"


def ranked(rows: Sequence[Sequence[Cell]]) -> list[list[Cell]]:
    """The rows with the highest value of each column marked as best and the next one as second, equal ones alike."""
    columns = [_ranked(column) for column in zip(*rows, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def ranked_across(row: Sequence[Cell]) -> list[Cell]:
    """The same within one row."""
    return _ranked(row)


def _ranked(cells: Sequence[Cell]) -> list[Cell]:
    # as printed: what looks equal is equal
    best = sorted({round(cell.value, 3) for cell in cells if cell.value is not None}, reverse=True)[:2]
    if sum(cell.value is not None for cell in cells) < 2:
        return list(cells)
    return [
        replace(cell, rank=best.index(round(cell.value, 3)) + 1)
        if cell.value is not None and round(cell.value, 3) in best
        else cell
        for cell in cells
    ]


def _scaled(value: float | None, factor: float, digits: int, otherwise: str) -> str:
    return otherwise if value is None else f"{factor * value:.{digits}f}"


def _rich(cell: Cell) -> Text:
    styles = ["", "bold", "underline"][cell.rank], "dim" if cell.faint else ""
    return Text(cell.text, style=" ".join(filter(None, styles)))


def _markdown(cell: Cell) -> str:
    text = cell.text.replace("|", "\\|").replace("*", "\\*")
    return {1: f"**{text}**", 2: f"<u>{text}</u>"}.get(cell.rank, text)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
