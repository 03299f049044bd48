"""What carries a piece that does not stand on the floor."""

import numpy as np
import trimesh
from numpy.random import Generator

from objgraph.synthetic.furniture import Furniture
from objgraph.synthetic.parts import join
from objgraph.synthetic.scene import PlacedFurniture, stand
from objgraph.training.meshes.files import canonical

CARRIED = frozenset({"display"})
"""Categories that stand on a desk."""
TOP_M = (0.45, 0.78)
"""Height of its top, from a low board under a television to an office's desk."""
_DEPTH_M = (0.45, 0.85)
_BESIDE_M = (0.1, 0.9)
"""By how much it is wider than what it carries."""
_BEFORE_M = 0.1
"""Least by which it is deeper."""
_BOARD_M = 0.03


def on_desk(piece: PlacedFurniture, rng: Generator) -> tuple[PlacedFurniture, PlacedFurniture]:
    """A piece that was put on the floor, raised onto a desk made for it, towards its rear; and the desk. Both look one way."""
    width, _, depth = piece.scale * piece.piece.mesh.extents
    top = rng.uniform(*TOP_M)
    half = np.array([width + rng.uniform(*_BESIDE_M), max(depth + _BEFORE_M, rng.uniform(*_DEPTH_M))]) / 2
    room = half - np.array([width, depth]) / 2
    aside, back = room * [rng.uniform(-1, 1), rng.uniform(0, 1)]
    raised = piece.T_world_object.copy()
    raised[2, 3] += top
    forward = -piece.T_world_object[:2, 2]
    middle = piece.T_world_object[:2, 3] - aside * piece.T_world_object[:2, 0] + back * forward
    mesh = _desk(half, top, legs=bool(rng.random() < 0.5))
    desk = Furniture("table", "desk", canonical(mesh, "desk"), float(np.linalg.norm(mesh.extents)), 2)
    # at yaw 0 the front looks along +y
    yaw = float(np.arctan2(-forward[0], forward[1]))
    return PlacedFurniture(piece.piece, raised, piece.scale), stand(
        desk, np.full(3, desk.diagonal_m), middle, yaw
    )


def _desk(half: np.ndarray, top: float, *, legs: bool) -> trimesh.Trimesh:
    """A board on four legs or on two sides; y up, metres."""
    (x, z), under = half, top - _BOARD_M
    boxes = [((-x, under, -z), (x, top, z))]
    for side in (-1, 1):
        outer, inner = side * x, side * (x - _BOARD_M)
        for end in (-1, 1) if legs else (0,):
            reach = (end * z, end * (z - _BOARD_M)) if legs else (-z, z)
            low, high = np.sort([[outer, inner], reach], axis=1).T
            boxes.append(((low[0], 0, low[1]), (high[0], under, high[1])))
    return join([trimesh.creation.box(bounds=np.array(box, float)) for box in boxes])
