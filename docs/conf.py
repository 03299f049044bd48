"""The site: pages in MyST Markdown; the API from docstrings, the commands from their own help, the examples as they are."""

import ast
import contextlib
import io
import os
from collections.abc import Iterator
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
_MADE = _HERE / "reference" / "made"
"""Pages that are written anew with every build."""


def _pages() -> Iterator[tuple[str, str]]:
    """Names and text."""
    yield from _commands()
    yield from _api()
    yield from _examples()


def _commands() -> Iterator[tuple[str, str]]:
    """Every verb's help, as it is printed."""
    from objgraph.cli.main import VERBS, main

    for verb in VERBS:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            main([verb, "--help-all"])
        yield f"command-{verb}", f"# objgraph {verb}\n\n```text\n{printed.getvalue().rstrip()}\n```\n"


def _api() -> Iterator[tuple[str, str]]:
    """What `objgraph` exports, a page a name, and what its rooms export, a page a room."""
    import objgraph

    rooms = [name for name in objgraph.__all__ if name in objgraph._ROOMS]
    own = [name for name in objgraph.__all__ if name not in rooms]
    told = {id(getattr(objgraph, name)) for name in own}
    for name in own:
        yield f"api-{name}", f"# objgraph.{name}\n\n{_described('objgraph', name)}"
    for room in rooms:
        module = import_module(f"objgraph.{room}")
        names = [name for name in module.__all__ if id(getattr(module, name)) not in told]
        body = "\n".join(_described(module.__name__, name) for name in names)
        yield f"room-{room}", f"# objgraph.{room}\n\n{module.__doc__}\n\n{body}"


def _described(module: str, name: str) -> str:
    found = getattr(import_module(module), name)
    kind = "class" if isinstance(found, type) else "function" if callable(found) else "data"
    members = "   :members:\n" if kind == "class" else ""
    return f"```{{eval-rst}}\n.. auto{kind}:: {module}.{name}\n{members}```\n"


def _examples() -> Iterator[tuple[str, str]]:
    for path in sorted((_HERE.parent / "examples").glob("*.py")):
        title = (ast.get_docstring(ast.parse(path.read_text())) or path.stem).splitlines()[0].rstrip(".")
        included = f"../../../examples/{path.name}"
        code = f"```{{literalinclude}} {included}\n:language: python\n```\n"
        yield f"example-{path.stem}", f"# {path.name}\n\n{title}.\n\n{code}"


def _write(app) -> None:
    _MADE.mkdir(exist_ok=True)
    pages = {f"{name}.md": text for name, text in _pages()}
    for path in _MADE.iterdir():
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        path = _MADE / name
        if not path.exists() or path.read_text() != text:  # unchanged pages are not built again
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
