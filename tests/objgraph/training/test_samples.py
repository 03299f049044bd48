"""Signed distances of meshes good and bad, against closed forms; samples and their cache."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from objgraph.errors import PriorError
from objgraph.training.meshes.files import MeshError
from objgraph.training.meshes.samples import SampleConfig, load_samples, sample_solid, save_samples
from objgraph.training.meshes.solid import SHEET_HALF_THICKNESS, Solid, SolidDistance, solidify
from objgraph.training.meshes.warps import random_warp

CONFIG = SampleConfig(count=2000)


def box_distance(points: NDArray, extents: tuple[float, float, float]) -> NDArray:
    """Closed form of a centred box."""
    q = np.abs(points) - np.array(extents) / 2
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)


@pytest.fixture(scope="module")
def points() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform(-0.6, 0.6, (3000, 3))


def test_box(points: NDArray) -> None:
    extents = (0.8, 0.2, 0.5)
    solid = solidify(trimesh.creation.box(extents), "box")
    assert_allclose(SolidDistance(solid)(points), box_distance(points, extents), atol=1e-5)


def test_sphere(points: NDArray) -> None:
    solid = solidify(trimesh.creation.icosphere(5, 0.4), "sphere")
    assert_allclose(SolidDistance(solid)(points), np.linalg.norm(points, axis=1) - 0.4, atol=1e-3)


def test_sheet_becomes_a_thin_solid(points: NDArray) -> None:
    square = trimesh.Trimesh(
        [[-0.4, 0, -0.4], [0.4, 0, -0.4], [0.4, 0, 0.4], [-0.4, 0, 0.4]], [[0, 2, 1], [0, 3, 2]]
    )
    distance = SolidDistance(solidify(square, "sheet"))
    expected = np.linalg.norm(points - np.clip(points, [-0.4, 0, -0.4], [0.4, 0, 0.4]), axis=1)
    assert_allclose(distance(points), expected - SHEET_HALF_THICKNESS, atol=1e-5)
    assert (distance(np.array([[0.1, 0.001, 0.2], [0.1, -0.001, 0.2]])) < 0).all()


def test_missing_side_of_a_box_is_filled(points: NDArray) -> None:
    extents = (0.6, 0.6, 0.5)
    whole = trimesh.creation.box(extents)
    lidless = trimesh.Trimesh(whole.vertices, whole.faces[whole.face_normals[:, 1] < 0.5], process=False)
    distance = SolidDistance(solidify(lidless, "lidless"))
    assert_allclose(distance(points), box_distance(points, extents), atol=1e-5)


def test_bowl_becomes_a_thin_wall_and_stays_hollow() -> None:
    ball = trimesh.creation.icosphere(4, 0.4)
    bowl = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 1] < 0.2], process=False)
    distance = SolidDistance(solidify(bowl, "bowl"))
    wall = distance(np.array([[0.4, 0, 0], [0, -0.4, 0], [0.24, -0.32, 0]]))
    assert_allclose(wall, -SHEET_HALF_THICKNESS, atol=1.5e-3)
    assert_allclose(
        distance(np.array([[0.3, 0, 0], [0.45, 0, 0], [0, -0.3, 0]])), [0.097, 0.047, 0.097], atol=2e-3
    )


def test_box_of_loose_faces_is_solid(points: NDArray) -> None:
    extents = (0.6, 0.6, 0.5)
    whole = trimesh.creation.box(extents).subdivide()
    loose = trimesh.Trimesh(
        whole.triangles.reshape(-1, 3), np.arange(3 * len(whole.faces)).reshape(-1, 3), process=False
    )
    distance, expected = SolidDistance(solidify(loose, "loose"))(points), box_distance(points, extents)
    assert_allclose(distance[expected > 0], expected[expected > 0], atol=1e-5)
    assert (distance[expected < -0.01] < 0).all()


def test_overlapping_parts_are_one_solid(points: NDArray) -> None:
    first, second = trimesh.creation.box((0.9, 0.1, 0.1)), trimesh.creation.box((0.1, 0.9, 0.1))
    solid = solidify(trimesh.util.concatenate([first, second]), "cross")  # pyright: ignore[reportArgumentType]
    expected = np.minimum(box_distance(points, (0.9, 0.1, 0.1)), box_distance(points, (0.1, 0.9, 0.1)))
    assert_allclose(SolidDistance(solid)(points), expected, atol=1e-5)


def test_inside_out_mesh_has_the_same_distance(points: NDArray) -> None:
    mesh = trimesh.creation.box((0.5, 0.5, 0.5))
    mesh.invert()
    assert_allclose(
        SolidDistance(solidify(mesh, "inverted"))(points), box_distance(points, (0.5, 0.5, 0.5)), atol=1e-5
    )


@pytest.mark.parametrize("vertices", [np.full((3, 3), np.nan), np.empty((0, 3))])
def test_unusable_mesh_is_named(vertices: NDArray) -> None:
    faces = np.arange(3)[None] if len(vertices) else np.empty((0, 3), int)
    with pytest.raises(PriorError, match=r"mesh broken\.ply is empty or has vertices that are not finite"):
        solidify(trimesh.Trimesh(vertices, faces, process=False), "broken.ply")


def test_a_mesh_without_area_is_named() -> None:
    line = trimesh.Trimesh([[0, 0, 0], [0.5, 0, 0], [1, 0, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(MeshError, match=r"mesh line\.ply has no area"):
        solidify(line, "line.ply")


def test_samples_are_true_distances_and_repeat() -> None:
    extents = (0.8, 0.2, 0.5)
    solid = Solid("box", (trimesh.creation.box(extents),))
    samples = sample_solid(solid, CONFIG, seed=1)
    again = sample_solid(solid, CONFIG, seed=1)
    assert_allclose(samples.points, again.points, atol=0)
    assert_allclose(samples.sdf, box_distance(samples.points, extents), atol=1e-5)
    assert samples.points.shape == (2000, 3)
    # nearer share, farther share, and uniform ones
    near, far = round(CONFIG.near_share * 2000), round((CONFIG.near_share + CONFIG.far_share) * 2000)
    assert np.abs(samples.sdf[:near]).max() < 6 * CONFIG.near_sigma
    assert np.abs(samples.sdf[near:far]).max() > 6 * CONFIG.near_sigma
    assert (np.abs(samples.points[far : far + 400]) <= 0.55 * samples.extents + 1e-6).all()
    assert np.abs(samples.sdf[-500:]).max() > 0.2
    assert 0.2 < (samples.sdf < 0).mean() < 0.6


def test_damaged_cache_is_drawn_again(tmp_path: Path) -> None:
    samples = sample_solid(Solid("box", (trimesh.creation.box((0.5, 0.5, 0.5)),)), CONFIG, seed=1)
    path = tmp_path / "folder" / "a.safetensors"
    assert load_samples(path, "box") is None
    save_samples(samples, path)
    loaded = load_samples(path, "box")
    assert loaded is not None
    assert_allclose(loaded.sdf, samples.sdf, atol=0)
    path.write_bytes(path.read_bytes()[:100])
    assert load_samples(path, "box") is None


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_warps_keep_the_frame_and_the_surface_closed(seed: int) -> None:
    solid = Solid("ball", (trimesh.creation.icosphere(2, 0.5),))
    (mesh,) = solid.warped(random_warp(np.random.default_rng(seed))).closed
    assert_allclose(np.linalg.norm(mesh.extents), 1)
    assert_allclose(mesh.bounds.sum(0), 0, atol=1e-9)
    assert mesh.is_watertight
    assert mesh.volume > 0
    # mirror symmetry in x survives
    flipped = mesh.vertices * [-1, 1, 1]
    nearest = np.linalg.norm(mesh.vertices[:, None] - flipped[None], axis=2).min(1)
    assert nearest.max() < 1e-9
