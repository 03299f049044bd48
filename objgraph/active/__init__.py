"""Where to look next, from what a map does not know."""

from objgraph.active.cameras import reachable, sphere
from objgraph.active.from_map import known_objects
from objgraph.active.next_view import next_views

__all__ = ["known_objects", "next_views", "reachable", "sphere"]
