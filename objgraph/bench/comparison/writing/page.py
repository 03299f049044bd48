"""A comparison as one HTML file: its tables, which a click on a column sorts, and its pictures."""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from objgraph.bench.comparison.writing.grid import Cell, Grid

PAGE = "report.html"
_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:">
<title>{title}</title>
<style>
body {{ font: 14px/1.45 system-ui, sans-serif; color: #1c2128; margin: 16px 24px 40px; }}
h1 {{ font-size: 20px; }} h2 {{ font-size: 16px; margin: 28px 0 6px; }}
code {{ background: #f5f6f8; padding: 2px 6px; border-radius: 3px; overflow-wrap: anywhere; }}
div {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 4px 10px; text-align: right; border-bottom: 1px solid #d8dce2; white-space: nowrap; }}
th {{ vertical-align: bottom; }}
th.words, td.words {{ text-align: left; }}
th button {{ all: unset; cursor: pointer; font-weight: 600; white-space: pre-line; }}
th button:focus-visible {{ outline: 2px solid #d55e00; }}
th[aria-sort=ascending] button::after {{ content: " \\2191"; }} th[aria-sort=descending] button::after {{ content: " \\2193"; }}
td.best {{ font-weight: 700; }} td.second {{ text-decoration: underline; }} td.faint {{ color: #6e7781; }}
p {{ max-width: 100ch; color: #57606a; }}
img {{ max-width: 100%; }}
</style></head><body>
"""
_SCRIPT = """<script>
"use strict";
for (const head of document.querySelectorAll("th")) {
  head.querySelector("button").addEventListener("click", () => {
    const falling = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentElement.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", falling ? "descending" : "ascending");
    const body = head.closest("table").tBodies[0];
    const text = (row) => row.cells[head.cellIndex].textContent;
    const number = (row) => (text(row).startsWith("\\u221e") ? Infinity : parseFloat(text(row)));
    const words = head.classList.contains("words");
    const order = (a, b) => {
      if (words) return text(a).localeCompare(text(b), undefined, { numeric: true });
      const [x, y] = [number(a), number(b)];
      return x === y ? 0 : x - y;
    };
    const known = (row) => words || !Number.isNaN(number(row));
    const rows = [...body.rows];
    const sorted = rows.filter(known).sort(order);
    if (falling) sorted.reverse();
    body.append(...sorted, ...rows.filter((row) => !known(row)));
  });
}
</script></body></html>
"""


def page_of(title: str, about: str, tables: Sequence[Grid], pictures: Sequence[Path]) -> str:
    """The page's text; pictures that were not drawn are left out."""
    parts = [_HEAD.format(title=escape(title)), f"<h1>{escape(title)}</h1>\n<p>{about}</p>\n"]
    parts += [_table(table) for table in tables]
    for path in pictures:
        if path.is_file():
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            parts.append(
                f'<h2>{escape(path.stem.replace("_", " "))}</h2>\n<img alt="{escape(path.stem)}" src="data:image/png;base64,{data}">\n'
            )
    return "".join([*parts, _SCRIPT])


def _table(grid: Grid) -> str:
    kinds = ["words" if i < grid.words else "" for i in range(len(grid.header))]
    head = "".join(
        f'<th class="{kind}"><button>{escape(name)}</button></th>'
        for kind, name in zip(kinds, grid.header, strict=True)
    )
    rows = "\n".join(
        "<tr>" + "".join(_cell(cell, kind) for cell, kind in zip(row, kinds, strict=True)) + "</tr>"
        for section in grid.sections
        for row in section
    )
    caption = f"<p>{escape(grid.caption)}</p>\n" if grid.caption else ""
    return f"<h2>{escape(grid.title)}</h2>\n<div><table><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table></div>\n{caption}"


def _cell(cell: Cell, kind: str) -> str:
    marks = (kind, ("", "best", "second")[cell.rank], "faint" * cell.faint)
    return f'<td class="{" ".join(filter(None, marks))}">{escape(cell.text)}</td>'
