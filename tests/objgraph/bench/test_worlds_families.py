"""The benchmark's furniture: closed, canonical, of a real size, of the stated symmetry, and of no trained family."""

from typing import Any

import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.bench.worlds.boards import half_round, lathe, ring, smooth, strip
from objgraph.bench.worlds.families import FAMILIES, make_piece
from objgraph.bench.worlds.meshes import symmetry_of
from objgraph.families import FAMILIES as TRAINED
from objgraph.synthetic.furniture import FAMILIES as SAMPLE

ALL: list[tuple[Any, str]] = [
    (category, family) for category, families in FAMILIES.items() for family in families
]
NARROW = {"board": 0.35}


def scene_of(mesh: trimesh.Trimesh) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    return scene


@pytest.mark.parametrize(("category", "family"), ALL)
def test_pieces_are_canonical_closed_and_of_a_real_size(category, family):
    for seed in range(12):
        piece = make_piece(category, family, np.random.default_rng(seed))
        np.testing.assert_allclose(piece.mesh.bounds.mean(axis=0), 0, atol=1e-12)
        assert np.linalg.norm(piece.mesh.extents) == pytest.approx(1)
        assert piece.mesh.is_watertight
        assert piece.mesh.is_winding_consistent
        assert all(part.volume > 0 for part in piece.mesh.split(only_watertight=False))
        width, height, depth = piece.diagonal_m * piece.mesh.extents
        if category == "chair":
            assert 0.75 < height < 1.15
            assert NARROW.get(family, 0.4) < width < 0.95
            assert 0.4 < depth < 1.15
        else:
            assert 0.4 < height < 0.79
            assert depth - 1e-2 <= width < 2.0


@pytest.mark.parametrize(("category", "family"), ALL)
def test_every_part_hangs_together_with_what_stands_on_the_floor(category, family):
    for seed in range(4):
        piece = make_piece(category, family, np.random.default_rng(seed))
        parts = piece.mesh.split(only_watertight=False)
        grown = 0.008 / piece.diagonal_m
        clouds = [
            np.concatenate([part.vertices, trimesh.sample.sample_surface(part, 300, seed=0)[0]])
            for part in parts
        ]
        scenes = [scene_of(part) for part in parts]

        def touch(i, j, clouds=clouds, scenes=scenes, parts=parts, grown=grown):
            low, high = parts[j].bounds + [[-grown] * 3, [grown] * 3]
            near = clouds[i][((clouds[i] >= low) & (clouds[i] <= high)).all(axis=1)]
            return (
                len(near) and scenes[j].compute_signed_distance(near.astype(np.float32)).numpy().min() < grown
            )

        floor = piece.mesh.bounds[0, 1] + 0.01 / piece.diagonal_m
        reached = [i for i, part in enumerate(parts) if part.bounds[0, 1] < floor]
        rest, queue = set(range(len(parts))) - set(reached), list(reached)
        while queue:
            i = queue.pop()
            new = {j for j in rest if touch(i, j) or touch(j, i)}
            rest -= new
            queue += new
        assert not rest


@pytest.mark.parametrize("family", FAMILIES["chair"])
def test_chairs_face_minus_z(family):
    for seed in range(4):
        vertices = make_piece("chair", family, np.random.default_rng(seed)).mesh.vertices
        crown = vertices[vertices[:, 1] > 0.9 * vertices[:, 1].max()]
        assert crown[:, 2].mean() > 0.1


@pytest.mark.parametrize("family", FAMILIES["table"])
def test_the_symmetry_stated_is_the_one_found(family):
    for seed in range(3):
        piece = make_piece("table", family, np.random.default_rng(seed))
        found = symmetry_of(piece.mesh)
        # a turned cage's rods need not fall on each other, but do at quarter turns
        assert found % 4 == 0 if family == "cage" else found == piece.symmetry


def stool(legs: int) -> trimesh.Trimesh:
    """A disc on so many legs."""
    mesh = trimesh.creation.cylinder(0.3, segment=[[0, 0.3, 0], [0, 0.33, 0]], sections=96)
    for angle in 2 * np.pi * np.arange(legs) / legs:
        foot = [0.25 * np.cos(angle), -0.33, 0.25 * np.sin(angle)]
        mesh += trimesh.creation.cylinder(0.03, segment=[foot, [foot[0], 0.3, foot[2]]])
    return mesh


def test_simple_shapes_have_their_symmetry():
    assert symmetry_of(trimesh.creation.box(extents=(0.5, 0.2, 0.5))) == 4
    assert symmetry_of(trimesh.creation.box(extents=(0.5, 0.2, 0.3))) == 2
    rod = trimesh.creation.cylinder(0.3, segment=[[0, -0.2, 0], [0, 0.2, 0]], sections=64)
    assert symmetry_of(rod) == 0
    for legs in (3, 4, 5, 6):
        assert symmetry_of(stool(legs)) == legs
    handle = trimesh.creation.box(bounds=[[0, 0, 0], [0.5, 0.1, 0.1]])
    assert symmetry_of(rod + handle) == 1


def test_a_seed_gives_one_shape_and_seeds_differ():
    for category, family in ALL:
        a, b, c = (make_piece(category, family, np.random.default_rng(seed)) for seed in (1, 1, 2))
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        assert a.diagonal_m == b.diagonal_m != c.diagonal_m


def test_no_family_was_trained_on_or_stands_in_the_sample():
    for category, families in FAMILIES.items():
        assert len(families) >= 6
        assert not set(families) & (set(TRAINED[category]) | set(SAMPLE[category]))


lengths = st.floats(0.05, 2.0)


@settings(max_examples=40)
@given(lengths, lengths, st.floats(0.005, 0.04))
def test_boards_and_turned_parts_have_the_volumes_of_the_closed_forms(a, b, thickness):
    flat = strip([(0, 0, 0), (0, 0.3 * a, 0), (0, a, 0)], (b / 2, 0, 0), thickness)
    assert abs(flat.volume) == pytest.approx(a * b * thickness)
    cone = lathe([(0.5 * a, 0.1), (0.25 * a, 0.1 + b)], 0.4, -0.2, sections=96)
    exact = np.pi * b / 3 * a**2 * (0.25 + 0.125 + 0.0625)
    assert abs(cone.volume) == pytest.approx(exact, rel=5e-3)
    plate = half_round(a, b, 0.1, 0.5, 0.5 + thickness)
    assert abs(plate.volume) == pytest.approx(np.pi / 2 * a * b * thickness, rel=0.02)
    np.testing.assert_allclose(plate.bounds[:, 1], [0.5, 0.5 + thickness])


def test_curves_pass_where_they_should():
    closed = ring((0.5, 0.3), 0.2, 0.01)
    np.testing.assert_allclose(closed.extents, [1.02, 0.02, 0.62], atol=5e-3)
    knots = np.array([[0, 0, 0], [0, 1, 0.5], [0, 2, 0]], dtype=float)
    curve = smooth(knots, 31)
    np.testing.assert_allclose(curve[[0, 15, 30]], knots, atol=1e-12)
    assert curve[:, 2].max() <= 0.5 + 1e-12
