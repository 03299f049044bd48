"""Pictures and tables of maps."""

from objgraph.show.map_picture import map_picture
from objgraph.show.next_view import sphere_picture
from objgraph.show.street_picture import street_picture
from objgraph.show.tables import map_table

__all__ = ["map_picture", "map_table", "sphere_picture", "street_picture"]
