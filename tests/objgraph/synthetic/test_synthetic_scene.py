"""Furniture, layout, camera, rendering and sensor of the sample scene."""

from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph.geometry.boxes import OrientedBox, intersection_volume
from objgraph.synthetic.camera import CameraConfig, camera_matrix, camera_path
from objgraph.synthetic.furniture import FAMILIES, make_furniture
from objgraph.synthetic.parts import arc, beam, column, rounded, sheet
from objgraph.synthetic.render import Renderer
from objgraph.synthetic.scene import RoomConfig, furnish, overlap, room_shell
from objgraph.synthetic.sensor import SensorConfig, sense_depth, sense_masks

ALL: list[tuple[Any, str]] = [
    (category, family) for category, families in FAMILIES.items() for family in families
]
ROOM = RoomConfig()


@pytest.mark.parametrize(("category", "family"), ALL)
def test_furniture_is_canonical_closed_and_of_a_real_size(category, family):
    for seed in range(4):
        piece = make_furniture(category, family, np.random.default_rng(seed))
        np.testing.assert_allclose(piece.mesh.bounds.mean(axis=0), 0, atol=1e-12)
        assert np.linalg.norm(piece.mesh.extents) == pytest.approx(1)
        assert piece.mesh.is_watertight
        assert piece.mesh.is_winding_consistent
        assert all(part.volume > 0 for part in piece.mesh.split(only_watertight=False))
        width, height, depth = piece.diagonal_m * piece.mesh.extents
        if category == "chair":
            assert 0.4 < width < 0.85
            assert 0.7 < height < 1.1
            assert 0.4 < depth < 0.85
        else:
            assert 0.4 < height < 0.8
            assert depth - 1e-6 <= width < 1.7


@pytest.mark.parametrize("family", FAMILIES["chair"])
def test_chairs_face_minus_z(family):
    for seed in range(4):
        vertices = make_furniture("chair", family, np.random.default_rng(seed)).mesh.vertices
        crown = vertices[vertices[:, 1] > 0.9 * vertices[:, 1].max()]
        assert crown[:, 2].mean() > 0.1


@pytest.mark.parametrize(("category", "family"), ALL)
def test_the_symmetry_class_is_that_of_the_shape(category, family):
    for seed in range(3):
        piece = make_furniture(category, family, np.random.default_rng(seed))
        order = piece.symmetry or 12
        points = piece.mesh.vertices

        def gap(angle, points=points, mesh=piece.mesh):
            turned = trimesh.transform_points(
                points, trimesh.transformations.rotation_matrix(angle, [0, 1, 0])
            )
            return np.max(trimesh.proximity.ProximityQuery(mesh).vertex(turned)[0])

        if order > 1:
            assert gap(2 * np.pi / order) < 0.01
        if piece.symmetry:
            assert gap(np.pi / order) > 0.02


def test_a_seed_gives_one_shape_and_seeds_differ():
    for category, family in ALL:
        a, b, c = (make_furniture(category, family, np.random.default_rng(seed)) for seed in (1, 1, 2))
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        assert a.diagonal_m == b.diagonal_m != c.diagonal_m


def test_parts_have_the_volumes_of_the_closed_forms():
    many = 200
    assert beam([(0, 0, 0), (0, 2, 0)], 0.1, many).volume == pytest.approx(0.02 * np.pi, rel=1e-2)
    assert beam([(0, 0, 0), (1, 1, 0)], (0.1, 0.2), many).volume == pytest.approx(
        np.pi * np.sqrt(2) / 3 * (0.01 + 0.02 + 0.04), rel=1e-2
    )
    assert abs(column(0.5, 1, 3, 8).volume) == pytest.approx(2 * 2 * np.sqrt(2) * 0.25, rel=1e-9)
    x, y = np.meshgrid(np.linspace(0, 2, 5), np.linspace(0, 1, 4), indexing="ij")
    assert abs(sheet(np.stack([x, y, 0 * x], axis=-1), 0.1).volume) == pytest.approx(0.2)


def test_curves_pass_where_they_should():
    path = rounded([(0, 0, 0), (1, 0, 0), (1, 1, 0)], 0.2)
    np.testing.assert_allclose(path[[0, 1, -2, -1]], [[0, 0, 0], [0.8, 0, 0], [1, 0.2, 0], [1, 1, 0]])
    np.testing.assert_allclose(
        arc((0, 0, 0), (1, 2, 0), (2, 0, 0), 4)[[0, 2, 4]], [[0, 0, 0], [1, 2, 0], [2, 0, 0]]
    )


@pytest.mark.parametrize("seed", range(20))
def test_rooms_are_furnished_without_collisions(seed):
    placed = furnish(ROOM, np.random.default_rng(seed))
    assert sorted(p.piece.category for p in placed) == ["chair"] * 4 + ["table"] * 2
    assert len({p.piece.family for p in placed}) == 6
    for i, a in enumerate(placed):
        assert a.p_world[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert (np.abs(a.p_world[:, :2]) <= np.array(ROOM.size_m) / 2).all()
        assert not any(overlap(a.footprint, b.footprint) for b in placed[:i])
    table = placed[0]
    for chair in placed[1:4]:
        to_table = table.T_world_object[:2, 3] - chair.T_world_object[:2, 3]
        front = -chair.T_world_object[:2, 2]
        assert front @ to_table / np.linalg.norm(to_table) > 0.75


def rectangle(x, y, half_x, half_y, angle):
    c, s = np.cos(angle), np.sin(angle)
    corners = np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])
    return corners @ np.array([[c, s], [-s, c]]) + [x, y]


floats = st.tuples(*[st.floats(-1, 1)] * 2, *[st.floats(0.05, 0.7)] * 2, st.floats(-np.pi, np.pi))


@settings(max_examples=80, deadline=None)
@given(floats, floats)
def test_overlap_is_that_of_boxes_of_equal_height(a, b):
    boxes = [
        OrientedBox(
            np.array([x, y, 0]), Rotation.from_euler("z", angle).as_matrix(), np.array([2 * hx, 2 * hy, 1])
        )
        for x, y, hx, hy, angle in (a, b)
    ]
    shared = intersection_volume(*boxes)
    assume(shared == 0 or shared > 1e-6)  # touching may go either way
    assert overlap(rectangle(*a), rectangle(*b)) == (shared > 0)


def test_the_camera_is_level_inside_the_room_and_sees_the_furniture():
    config, targets = CameraConfig(), np.array([[0.0, 0.2, 0.4], [1.5, 1.2, 0.4], [-1.4, 1.0, 0.4]])
    path = camera_path(config, targets, np.random.default_rng(0))
    assert len(path) == config.frames
    K = camera_matrix(config)
    for T in path:
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) > 0
        assert T[2, 1] < -0.5  # the image's down is the world's
        assert (np.abs(T[:2, 3]) < np.array(ROOM.size_m) / 2).all()
        assert 1.2 < T[2, 3] < 1.7
        p_camera = (targets - T[:3, 3]) @ T[:3, :3]
        pixels = p_camera @ K.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        assert ((pixels > 0) & (pixels < [config.width, config.height])).all(axis=1).any()
    steps = np.linalg.norm(np.diff([T[:3, 3] for T in path], axis=0), axis=1)
    assert steps.max() < 0.6


def down_view(height=2.0):
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = height
    return T


def test_rendered_depth_is_z_depth_and_masks_name_the_piece():
    placed = furnish(RoomConfig(chairs=0, tables=1), np.random.default_rng(1))
    renderer = Renderer(placed, room_shell(ROOM), np.random.default_rng(0))
    config = CameraConfig(width=96, height=72)
    view = renderer.render(camera_matrix(config), down_view(), 96, 72)
    floor = view.instances == 0
    np.testing.assert_allclose(
        view.depth[0, 0], 2.0, atol=1e-5
    )  # at the corner too: along z, not along the ray
    assert floor.any()
    top = placed[0].p_world[:, 2].max()
    np.testing.assert_allclose(view.depth[view.instances == 1].min(), 2.0 - top, atol=1e-5)
    assert set(np.unique(view.instances)) == {0, 1}
    rays = np.linalg.norm(np.linalg.inv(camera_matrix(config)) @ [0, 0, 1])
    np.testing.assert_allclose(np.cos(view.incidence[0, 0]), 1 / rays, atol=1e-5)


def test_rays_into_the_open_have_no_depth_and_no_color():
    renderer = Renderer([], room_shell(RoomConfig(walls=0)), np.random.default_rng(0))
    up = np.eye(4)
    up[2, 3] = 1.0
    view = renderer.render(camera_matrix(CameraConfig(width=16, height=12)), up, 16, 12)
    assert not view.depth.any()
    assert not view.instances.any()
    assert not view.color.any()


def wall(z=2.0, shape=(200, 200), incidence=0.0):
    return np.full(shape, z), np.full(shape, incidence)


QUIET = SensorConfig(quantum=0, grazing_rad=(2, 3), edge_dropout=0)


@pytest.mark.parametrize("z", [0.8, 2.0, 3.5])
def test_axial_noise_grows_as_the_model_says(z):
    depth = sense_depth(*wall(z), QUIET, np.random.default_rng(0))
    assert depth.mean() == pytest.approx(z, abs=2e-4)
    assert depth.std() == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.05)


def test_depth_comes_in_steps_of_disparity():
    depth = sense_depth(*wall(2.0), SensorConfig(), np.random.default_rng(0))
    levels = np.unique(depth[depth > 0])
    assert 2 < len(levels) < 12
    np.testing.assert_allclose(np.diff(levels), 0.00285 * 4, rtol=0.05)


def test_grazing_surfaces_and_far_ones_have_no_depth():
    config = SensorConfig()
    rng = np.random.default_rng(0)
    assert not sense_depth(*wall(2.0, incidence=1.52), config, rng).any()
    assert not sense_depth(*wall(7.0), config, rng).any()
    assert not sense_depth(*wall(0.2), config, rng).any()
    assert sense_depth(*wall(2.0, incidence=1.0), config, rng).all()
    half = (sense_depth(*wall(2.0, incidence=sum(config.grazing_rad) / 2), config, rng) > 0).mean()
    assert half == pytest.approx(0.5, abs=0.03)


def test_depth_is_lost_and_mixed_at_edges_only():
    depth, incidence = wall(1.0)
    depth[:, 100:] = 2.0
    seen = sense_depth(depth, incidence, SensorConfig(), np.random.default_rng(0))
    wrong = (np.abs(seen - depth) > 0.1) & (seen > 0)
    assert wrong[:, 99:101].mean() > 0.05
    assert (seen[:, 99:101] == 0).mean() == pytest.approx(0.15, abs=0.06)
    far = np.abs(np.arange(200) - 99.5) > 2
    assert not wrong[:, far].any()
    assert seen[:, far].all()


def test_masks_move_by_about_a_pixel_at_their_borders():
    masks = np.zeros((200, 200), dtype=int)
    masks[40:160, 60:140] = 3
    moved = sense_masks(masks, SensorConfig(), np.random.default_rng(0))
    changed = np.argwhere(moved != masks)
    assert set(np.unique(moved)) == {0, 3}
    assert 20 < len(changed) < 800
    to_border = np.minimum.reduce(
        [np.abs(changed[:, 0] - b) for b in (39.5, 159.5)]
        + [np.abs(changed[:, 1] - b) for b in (59.5, 139.5)]
    )
    assert to_border.max() < 3.5


def test_a_sensor_without_faults_changes_nothing_and_seeds_repeat():
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 3, (40, 50))
    perfect = SensorConfig(0, 0, 0, 0, 0, (2, 3), 0, (0, 10), 0)
    np.testing.assert_array_equal(sense_depth(depth, 0 * depth, perfect, rng), depth)
    masks = rng.integers(0, 4, (40, 50))
    np.testing.assert_array_equal(sense_masks(masks, perfect, rng), masks)
    a, b, c = (sense_depth(depth, 0 * depth, SensorConfig(), np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()
