"""Triangles of every format, and what is none."""

import numpy as np
import pytest
import trimesh

from objgraph.geometry.mesh_data import parse_mesh, parse_points

KINDS = ("ply", "obj", "stl", "off", "glb")
CORNERS = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize("kind", KINDS)
def test_a_box_comes_back(kind):
    box = trimesh.creation.box([1, 2, 3])
    data = box.export(file_type=kind)
    mesh = parse_mesh(data if isinstance(data, bytes) else data.encode(), kind)  # type: ignore[union-attr]
    assert len(mesh.faces) == 12
    np.testing.assert_allclose(mesh.bounds, box.bounds, atol=1e-6)


def test_parts_of_a_scene_are_put_together_where_they_stand():
    scene = trimesh.Scene()
    for k in range(2):
        scene.add_geometry(
            trimesh.creation.box(), transform=trimesh.transformations.translation_matrix([5 * k, 0, 0])
        )
    mesh = parse_mesh(scene.export(file_type="glb"), "glb")  # type: ignore[arg-type]
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh.extents, [6, 1, 1], atol=1e-6)


@pytest.mark.parametrize("face", ["3 0 1 3", "3 0 1 -1", "3 0 1 2000000000"])
def test_a_face_of_a_vertex_that_there_is_not_is_refused(face):
    data = f"{CORNERS}{FACES}end_header\n0 0 0\n1 0 0\n0 1 0\n{face}\n".encode()
    with pytest.raises(ValueError, match="names a vertex outside of"):
        parse_mesh(data, "ply")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("data", [b"", b"no mesh", bytes(200)])
def test_what_is_none_is_refused(kind, data):
    with pytest.raises(ValueError, match=r"damaged|no faces"):
        parse_mesh(data, kind)


def test_points_need_no_faces():
    data = f"{CORNERS}end_header\n0 0 0\n1 0 0\n0 1 0\n".encode()
    np.testing.assert_array_equal(parse_points(data, "ply"), [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    with pytest.raises(ValueError, match="no vertices"):
        parse_points(CORNERS.replace("vertex 3", "vertex 0").encode() + b"end_header\n", "ply")
    with pytest.raises(ValueError, match="holds no faces"):
        parse_mesh(data, "ply")
