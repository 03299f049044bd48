"""Errors of a box's sides: what they add to its covariance, and which sides were seen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh.remesh import subdivide_to_size

from factors.errors import ObjectGraphError
from factors.state import ObjectState
from objgraph.covariance.sides import SEEN_M, SideMisfit, seen_sides, seen_vertices
from objgraph.errors import CovarianceError
from tests.toys import toy_mesh, toy_state

MISFIT = SideMisfit(2.0, 0.01, 0.2)
SHARES = st.lists(st.floats(0, 1), min_size=6, max_size=6).map(lambda v: np.reshape(v, (3, 2)))
EXTENTS = st.lists(st.floats(0.2, 3), min_size=3, max_size=3).map(np.array)


def test_sides_that_err_move_centre_and_extent_together():
    """The covariance is that of draws of all six sides."""
    extents, seen = np.array([1.5, 0.7, 0.8]), np.array([[1.0, 0.0], [1.0, 0.5], [0.2, 0.9]])
    outward = MISFIT.sigma(extents, seen) * np.random.default_rng(0).normal(size=(400_000, 3, 2))
    centre, edge = (outward[..., 1] - outward[..., 0]) / 2, outward.sum(axis=-1)
    drawn = np.cov(np.concatenate([centre, edge / extents], axis=1).T)
    found = MISFIT.matrix(extents, seen)
    assert not found[:3].any()
    assert not found[:, :3].any()
    scale = np.sqrt(np.diag(found)[3:])
    np.testing.assert_allclose(
        drawn / np.outer(scale, scale), found[3:, 3:] / np.outer(scale, scale), atol=0.01
    )


@given(EXTENTS, SHARES)
def test_it_is_a_covariance_that_shrinks_with_what_is_seen(extents, seen):
    matrix = MISFIT.matrix(extents, seen)
    assert np.linalg.eigvalsh(matrix).min() > -1e-12
    more = MISFIT.matrix(extents, np.minimum(seen + 0.1, 1.0))
    assert (np.diag(more) <= np.diag(matrix) + 1e-12).all()
    sigma = MISFIT.sigma(extents, seen)
    assert (sigma >= 0.01 - 1e-12).all()
    assert (sigma <= np.maximum(0.2 * extents[:, None], 0.01) + 1e-12).all()


def test_many_boxes_are_done_at_once():
    rng = np.random.default_rng(1)
    extents, seen = rng.uniform(0.3, 2, (5, 3)), rng.uniform(size=(5, 3, 2))
    each = [MISFIT.matrix(*one) for one in zip(extents, seen, strict=True)]
    np.testing.assert_array_equal(MISFIT.matrix(extents, seen), each)


@pytest.mark.parametrize(
    "values", [(0.0, 0.01, 0.2), (1.0, -0.01, 0.2), (1.0, 0.01, float("nan")), (1.0, "a", 0.1)]
)
def test_misfits_that_are_none_are_refused(values):
    with pytest.raises(CovarianceError, match="the sides' "):
        SideMisfit(*values)


def test_what_lies_near_a_point_was_seen():
    vertices = np.array([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]])
    points = np.array([[0.0, 0.9 * SEEN_M, 0], [0.5, 1.1 * SEEN_M, 0], [np.nan, 0, 0]])
    assert seen_vertices(vertices, points).tolist() == [True, False, False]
    assert not seen_vertices(vertices, np.full((2, 3), np.nan)).any()


def surface(state: ObjectState) -> np.ndarray:
    mesh = toy_mesh(state.code)
    return state.to_world(subdivide_to_size(mesh.vertices, mesh.faces, 0.05)[0])


def test_sides_are_those_along_the_object_s_axes():
    state = toy_state(0.7)
    vertices = surface(state)
    left = state.to_object(vertices)[:, 0] < 0
    shares = seen_sides(state, vertices, left)
    assert shares[0, 0] == 1.0
    assert shares[0, 1] == 0.0
    assert (shares[1:] > 0.2).all()
    assert (shares[1:] < 0.8).all()


def test_who_stands_on_a_known_floor_has_its_lower_side_there():
    state = toy_state()
    nothing = np.zeros(len(surface(state)), bool)
    assert not seen_sides(state, surface(state), nothing).any()
    shares = seen_sides(state, surface(state), nothing, stands=True)
    assert shares[1, 0] == 1.0
    assert shares.sum() == 1.0


def test_a_surface_without_vertices_has_no_sides():
    with pytest.raises(ObjectGraphError, match="no sides"):
        seen_sides(toy_state(), np.zeros((0, 3)), np.zeros(0, bool))
