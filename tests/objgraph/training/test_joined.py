"""Loose parts are held by stems, narrow gaps are filled; what is too far off stays as it is."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.priors.mesh import field_grid, mesh_of_grid
from objgraph.training.meshes.joined import WHOLE, joined, pieces
from objgraph.training.meshes.solid import Solid, SolidDistance


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
    assert len(whole.closed) >= len(loose.closed) + count
    assert largest(whole) >= WHOLE
    np.testing.assert_allclose(whole.extents, loose.extents, atol=1e-3)


def test_one_piece_stays_as_it_is() -> None:
    solid = Solid("box", (box((0.5, 0.5, 0.5), (0.0, 0.0, 0.0)),))
    assert joined(solid) is solid


def test_what_is_far_apart_stays_apart() -> None:
    solid = Solid("two", tuple(box((0.2, 0.4, 0.4), (x, 0.0, 0.0)) for x in (-0.3, 0.3)))
    assert len(joined(solid).closed) == 2


@settings(max_examples=10, deadline=None)
@given(st.floats(0.01, 0.07), st.integers(0, 2**31))
def test_only_where_no_ball_gets_in_is_filled(gap: float, seed: int) -> None:
    """Two boards on a base: between them the middle is filled if the gap is narrower than a ball of radius 0.015."""
    base = box((0.6, 0.2, 0.4), (0.0, -0.2, 0.0))
    boards = [box((0.1, 0.4, 0.4), (side * (0.05 + gap / 2), 0.08, 0.0)) for side in (-1, 1)]
    before = Solid("boards", (base, *boards))
    distance, filled = SolidDistance(before), SolidDistance(joined(before))
    middle = np.array([[0.0, 0.1, 0.0]])
    if gap < 0.024:
        assert filled(middle)[0] < 0
    if gap > 0.036:
        assert filled(middle)[0] > 0
    # elsewhere nothing moves
    p = np.random.default_rng(seed).uniform(-0.5, 0.5, (2000, 3))
    p = p[(np.abs(p[:, 0]) > gap / 2 + 0.03) & (np.abs(p[:, 1] + 0.11) > 0.06)]
    near = np.abs(distance(p)) < 0.02
    np.testing.assert_allclose(filled(p)[near], distance(p)[near], atol=1e-5)


def test_cavities_are_filled() -> None:
    walls = [box((0.6, 0.02, 0.6), (0.0, y, 0.0)) for y in (-0.29, 0.29)]
    walls += [box((0.02, 0.6, 0.6), (x, 0.0, 0.0)) for x in (-0.29, 0.29)]
    walls += [box((0.6, 0.6, 0.02), (0.0, 0.0, z)) for z in (-0.29, 0.29)]
    hollow = Solid("chest", tuple(walls))
    assert SolidDistance(hollow)(np.zeros((1, 3)))[0] > 0.2
    assert SolidDistance(joined(hollow))(np.zeros((1, 3)))[0] < -0.2
