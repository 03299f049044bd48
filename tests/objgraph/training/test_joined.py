"""Loose parts are held by stems; what is in one piece, or too far off, stays as it is."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.priors.mesh import field_grid, mesh_of_grid
from objgraph.training.joined import WHOLE, joined, pieces
from objgraph.training.solid import Solid, SolidDistance


def box(size: tuple[float, float, float], centre: tuple[float, float, float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(centre)
    return mesh


def largest(solid: Solid) -> float:
    distance = SolidDistance(solid)
    grid = field_grid(lambda p: distance(p).astype(float), 96, 0.55, slope=1.2)
    return float(pieces(mesh_of_grid(grid, 0.55, remove_floaters=False))[1].max())


@settings(max_examples=10, deadline=None)
@given(st.floats(0.015, 0.05), st.integers(1, 4))
def test_castors_are_held(gap: float, count: int) -> None:
    places = [(0.3, -0.3), (-0.3, 0.3), (0.3, 0.3), (-0.3, -0.3)][:count]
    seat = box((0.8, 0.3, 0.8), (0.0, 0.1, 0.0))
    castors = [box((0.12, 0.1, 0.12), (x, -0.1 - gap, z)) for x, z in places]
    loose = Solid("castors", (seat, *castors))
    assert largest(loose) < WHOLE
    whole = joined(loose)
    assert len(whole.closed) == len(loose.closed) + count
    assert largest(whole) >= WHOLE
    np.testing.assert_allclose(whole.extents, loose.extents, atol=1e-6)


def test_one_piece_stays_as_it_is() -> None:
    solid = Solid("box", (box((0.5, 0.5, 0.5), (0.0, 0.0, 0.0)),))
    assert joined(solid) is solid


def test_what_is_far_apart_stays_apart() -> None:
    solid = Solid("two", tuple(box((0.2, 0.4, 0.4), (x, 0.0, 0.0)) for x in (-0.3, 0.3)))
    assert len(joined(solid).closed) == 2
