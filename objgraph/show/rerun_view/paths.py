"""Where things are in a recording, and in which colours."""

import rerun as rr
from matplotlib.colors import to_rgb

from objgraph.maps.colors import COLORS

WORLD = "world"
POINTS = f"{WORLD}/points"
TRAJECTORY = f"{WORLD}/trajectory"
CAMERA = f"{WORLD}/camera"
COLOR, DEPTH = f"{CAMERA}/color", f"{CAMERA}/depth"
MASKS, OUTLINES = f"{CAMERA}/masks", f"{CAMERA}/outlines"
OBJECTS = f"{WORLD}/objects"
ITERATE = f"{WORLD}/iterate"
TABLE = "table"
COST = "cost"
SIGMA = "centre_sigma_cm"
FRAME, ITERATION = "frame", "iteration"
"""Timelines."""
_COLORS = tuple(color for color in COLORS if color != "#000000")
"""The viewer's background is dark."""


def object_path(name: str, *parts: str) -> str:
    """Of an object, or of a part of it."""
    return "/".join([OBJECTS, rr.escape_entity_path_part(name.replace(" ", "_")), *parts])


def object_color(index: int) -> tuple[int, int, int]:
    """RGB of the map's object with this place in its list."""
    r, g, b = (round(255 * share) for share in to_rgb(_COLORS[index % len(_COLORS)]))
    return r, g, b
