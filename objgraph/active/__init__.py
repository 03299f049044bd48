"""Where to look next, from what a map does not know."""

from objgraph.active.cameras import reachable, sphere
from objgraph.active.from_map import targets_from_map
from objgraph.active.next_view import next_views

__all__ = ["next_views", "reachable", "sphere", "targets_from_map"]
