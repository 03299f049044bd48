"""Volumes, of flat meshes too."""

import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from objgraph.geometry.meshes import signed_volume
from objgraph.training.meshes.solid import solidify


@given(st.floats(0.01, 10), st.floats(0.01, 10), st.floats(0.01, 10), st.integers(0, 99))
def test_a_box_has_its_volume_wherever_it_is(x, y, z, seed):
    box = trimesh.creation.box((x, y, z), transform=trimesh.transformations.random_rotation_matrix())
    box.apply_translation(np.random.default_rng(seed).normal(size=3))
    assert signed_volume(box) == pytest.approx(x * y * z)
    box.invert()
    assert signed_volume(box) == pytest.approx(-x * y * z)


def test_a_flat_part_of_a_mesh_is_no_reason_to_warn():
    """Two sheets back to back are closed and have no volume; collected meshes have them."""
    board = trimesh.creation.box((1.0, 1.0, 1.0))
    sheets = trimesh.Trimesh(board.vertices * [1, 0, 1] + [0, 0.6, 0], board.faces, process=False)
    assert sheets.is_watertight
    mesh = trimesh.util.concatenate([trimesh.creation.box((1.0, 0.5, 1.0)), sheets])
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.apply_scale(0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert signed_volume(sheets) == 0.0
        solid = solidify(mesh, "box and sheet")
    assert len(solid.closed) == 1
