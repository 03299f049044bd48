"""The page: one file that needs no network and runs nothing but its own script."""

import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objgraph.atomic import write_file
from objgraph.errors import MapError
from objgraph.maps.files import EVALUATION
from objgraph.show.report.contents import map_contents
from objgraph.show.report.views import ObjectPicture
from objgraph.version import program_version

REPORT = "report.html"


def write_report(
    folder: Path | str,
    points_world: Float[np.ndarray, "n 3"] | None = None,
    colors: Float[np.ndarray, "n 3"] | None = None,
    pictures: Mapping[int, Sequence[ObjectPicture]] | None = None,
) -> Path:
    """Write `report.html` into the folder of a saved map.

    Points are the scan's, world frame, `colors` theirs as RGB in 0..1; `pictures` are views of the objects, by id.
    Without them the page has the map alone.

    Raises:
        MapError: there is no map, it is damaged, a number in it or in the errors beside it is too large to be shown, points
            and colours do not fit, or the folder cannot be written.
    """
    folder = Path(folder)
    contents = map_contents(folder, points_world, colors, pictures or {})
    contents["program"] = program_version()
    try:
        data = json.dumps(contents, allow_nan=False)
    except ValueError as error:
        raise MapError(
            f"{folder}: a number of the map or of {EVALUATION} is too large to be shown; map the scan again"
        ) from error
    # a name may hold what ends a script
    parts = {
        "title": html.escape(contents["title"]), "css": _asset("report.css"), "three": _asset("three.js"),
        "script": _asset("report.js"), "data": data.replace("<", "\\u003c"),
    }  # fmt: skip
    # in one pass: what is put in may look like a mark
    page = re.sub(r"\{\{(\w+)\}\}", lambda mark: parts[mark[1]], _asset("report.html"))
    write_file(folder / REPORT, page.encode(), MapError)
    return folder / REPORT


def _asset(name: str) -> str:
    return (files("objgraph.show.report") / "assets" / name).read_text(encoding="utf-8")
