"""Pictures and tables of maps."""

from importlib import import_module
from typing import TYPE_CHECKING

from objgraph.show.map_picture import map_picture
from objgraph.show.next_view import sphere_picture
from objgraph.show.street_picture import street_picture
from objgraph.show.tables import map_table

if TYPE_CHECKING:
    from objgraph.show import rerun_view as rerun_view

__all__ = ["map_picture", "map_table", "sphere_picture", "street_picture"]


def __getattr__(name: str):
    if name == "rerun_view":  # an optional part: its package may not be there
        return import_module("objgraph.show.rerun_view")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
