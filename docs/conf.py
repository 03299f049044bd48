"""The site: pages in MyST Markdown, the API from docstrings, the commands from their own help."""

import contextlib
import io
import os
from importlib import import_module
from pathlib import Path

os.environ["COLUMNS"] = "88"

project = "objgraph"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
html_theme = "furo"
html_title = "objgraph"
myst_heading_anchors = 3
exclude_patterns = ["_build"]
default_role = "code"
highlight_language = "text"
suppress_warnings = ["misc.highlighting_failure"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_maximum_signature_line_length = 100

_HERE = Path(__file__).parent


def _commands() -> str:
    """Every verb's help, as it is printed."""
    from objgraph.cli.main import VERBS, main, summary

    lines = ["# Commands\n", "`objgraph VERB --help`, of every verb.\n"]
    for verb in VERBS:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            main([verb, "--help"])
        lines += [f"## {verb}\n", f"{summary(verb)}\n", f"```text\n{printed.getvalue().rstrip()}\n```\n"]
    return "\n".join(lines)


def _api() -> str:
    """What `objgraph` exports, and the rooms' own exports."""
    import objgraph

    lines, told = ["# API\n", f"{objgraph.__doc__}\n"], set()
    rooms = [name for name in objgraph.__all__ if name in objgraph._ROOMS]
    own = [name for name in objgraph.__all__ if name not in rooms]
    for title, module, names in [
        ("objgraph", "objgraph", own),
        *((f"objgraph.{room}", f"objgraph.{room}", getattr(objgraph, room).__all__) for room in rooms),
    ]:
        lines += [f"## {title}\n", "```{eval-rst}"]
        for name in names:
            found = getattr(import_module(module), name)
            if id(found) in told:
                continue
            told.add(id(found))
            kind = "class" if isinstance(found, type) else "function" if callable(found) else "data"
            lines += [f".. auto{kind}:: {module}.{name}", *(["   :members:"] if kind == "class" else []), ""]
        lines += ["```\n"]
    return "\n".join(lines)


def _write(app) -> None:
    for name, text in (("commands", _commands()), ("api", _api())):
        path = _HERE / "reference" / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def _join(app, what, name, found, options, lines: list[str]) -> None:
    """An error's description under `Raises:` in one line, as reStructuredText wants it."""
    joined: list[str] = []
    for line in lines:
        if line.startswith(" " * 8) and joined and joined[-1].startswith("    "):
            joined[-1] += f" {line.strip()}"
        else:
            joined.append(line)
    lines[:] = joined


def setup(app) -> None:
    app.connect("builder-inited", _write)
    app.connect("autodoc-process-docstring", _join)
