"""By which turns a shape looks the same."""

import numpy as np
import trimesh
from numpy.testing import assert_allclose

from objgraph.geometry.symmetry import SAME, turn_gaps

SIXTEENTHS = 2 * np.pi * np.arange(16) / 16


def alike(mesh: trimesh.Trimesh) -> list[int]:
    return np.flatnonzero(turn_gaps(mesh, SIXTEENTHS) < SAME).tolist()


def test_boxes_and_what_is_round() -> None:
    assert alike(trimesh.creation.box((2.0, 1.0, 1.0))) == [0, 8]
    assert alike(trimesh.creation.box((1.0, 2.0, 1.0))) == [0, 4, 8, 12]
    rod = trimesh.creation.cylinder(0.3, 0.5, sections=64)
    rod.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    assert alike(rod) == list(range(16))


def test_handles_make_a_front() -> None:
    """They are 7 % of the surface, which lies a thousandth of the diagonal from itself turned on average."""
    chest = trimesh.creation.box((1.0, 0.8, 0.5))
    handles = [trimesh.creation.box((0.6, 0.06, 0.04)) for _ in range(2)]
    for handle, height in zip(handles, (-0.2, 0.2), strict=True):
        handle.apply_translation((0.0, height, -0.27))
    assert alike(sum(handles, chest)) == [0]


def test_the_gap_is_measured_in_diagonals() -> None:
    """Half a turn takes a rod that stands beside the middle of its plate to the other side: 0.4 of 1.7 away."""
    plate = trimesh.creation.box((1.5, 0.05, 0.5))
    rod = trimesh.creation.box((0.05, 0.8, 0.05))
    rod.apply_translation((0.2, 0.42, 0.0))
    mesh = plate + rod
    for scale in (1.0, 7.0):
        larger = trimesh.Trimesh(mesh.vertices * scale, mesh.faces)
        (gap,) = turn_gaps(larger, np.array([np.pi]))
        assert_allclose(gap, (0.4 - 0.05) / np.linalg.norm(mesh.extents), rtol=0.2)
