"""The renderer against geometry known in closed form, and the pictures' files."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from objgraph.errors import MapError
from objgraph.geometry.frames import look_at
from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.show import figure, raster
from objgraph.show import framing as views
from objgraph.show.map_picture import map_picture

UP = np.array([0.0, 0.0, 1.0])
RED, GREEN = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])


def ball(radius=0.5, center=(0.0, 0.0, 0.0), color=RED) -> raster.Surface:
    mesh = trimesh.creation.icosphere(4, radius=radius)
    vertices = np.asarray(mesh.vertices) + center
    return raster.Surface(vertices, np.asarray(mesh.faces), np.tile(color, (len(vertices), 1)))


def camera(distance=4.0) -> raster.Camera:
    T = look_at(np.array([0, -distance, 0]), np.zeros(3), UP)
    return raster.Camera(views.intrinsics_for(160, 120), T)


def test_look_at_gives_a_right_handed_upright_opencv_camera():
    T = camera().T_world_camera
    np.testing.assert_allclose(T[:3, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 1], -UP, atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    down = look_at(UP, np.zeros(3), UP)
    np.testing.assert_allclose(down[:3, :3].T @ down[:3, :3], np.eye(3), atol=1e-12)


def test_a_ball_covers_its_silhouette_and_has_its_depth():
    view = camera()
    layer = raster.draw_surfaces(view, [ball()])
    covered = np.isfinite(layer.depth)
    radius = view.intrinsics.fx * 0.5 / np.sqrt(4**2 - 0.5**2)
    assert covered.sum() == pytest.approx(np.pi * radius**2, rel=0.03)
    assert layer.depth.min() == pytest.approx(3.5, abs=5e-3)
    assert (layer.color[covered][:, 1:] == 0).all()
    assert layer.color[covered][:, 0].min() >= 0.45
    lit = layer.color[..., 0]
    assert lit[:60].sum() > lit[60:].sum()  # the lamp hangs above


@pytest.mark.parametrize("place", [(1e4, -1e4, 0.0), (6e5, 2e5, 400.0), (-9e5, 9e5, 0.0)])
def test_a_picture_is_the_same_wherever_the_world_begins(place):
    """In maps of surveyed coordinates too, where single precision has steps of centimetres."""
    here, there = camera(), camera()
    there.T_world_camera[:3, 3] += place
    drawn = raster.draw_surfaces(here, [ball(), ball(0.2, (0.5, -0.6, 0.3), GREEN)])
    moved = raster.draw_surfaces(
        there, [ball(center=place), ball(0.2, np.add(place, (0.5, -0.6, 0.3)), GREEN)]
    )
    both = np.isfinite(drawn.depth) & np.isfinite(moved.depth)
    assert (np.isfinite(drawn.depth) ^ np.isfinite(moved.depth)).sum() < 0.005 * both.sum()
    assert np.quantile(np.abs(moved.depth[both] - drawn.depth[both]), 0.99) < 1e-4
    assert np.quantile(np.abs(moved.color - drawn.color)[both], 0.99) < 0.01


def test_the_nearer_ball_hides_the_farther():
    layer = raster.draw_surfaces(camera(), [ball(), ball(0.2, (0, -1, 0), GREEN)])
    assert layer.color[60, 80, 1] > 0.4
    assert layer.color[60, 80, 0] == 0


def test_the_nearest_point_wins_whatever_the_order():
    points = np.array([[0, 0, 0], [0, -1, 0], [0, 1, 0.0]])
    colors = np.stack([RED, GREEN, RED])
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        layer = raster.draw_points(camera(), points[order], colors[order], 0.01)
        np.testing.assert_array_equal(layer.color[60, 80], GREEN)
        assert layer.depth.min() == pytest.approx(3)


def test_points_land_where_the_camera_projects_them_and_those_behind_it_do_not():
    view = camera()
    layer = raster.draw_points(view, np.array([[0.5, 0, 0.3], [0, -9, 0]]), np.stack([RED, GREEN]), 0.001)
    u, v, z = raster.project(view, np.array([[0.5, 0, 0.3]]))[0]
    drawn = np.argwhere(np.isfinite(layer.depth))
    np.testing.assert_array_equal(drawn, [[round(v), round(u)]])
    assert layer.depth[round(v), round(u)] == pytest.approx(z)
    assert u > 80
    assert v < 60


def test_composition_prefers_surfaces_within_the_bias_only():
    view = camera()
    surface = raster.draw_surfaces(view, [ball()])
    near = raster.draw_points(view, np.array([[0, -0.55, 0.0]]), GREEN[None], 0.02)
    for bias, wins in ((0.1, True), (0.01, False)):
        picture, shows = raster.compose(near, surface, np.ones(3), bias)
        assert shows[60, 80] == wins
        assert (picture[60, 80, 1] == 1) == (not wins)
    np.testing.assert_array_equal(picture[0, 0], np.ones(3))


@pytest.mark.parametrize("direction", [[0, 0, 1.0], [0.6, 0, 0.8], [0, -1.0, 0]])
def test_a_framing_camera_has_everything_in_the_picture_and_wastes_little(direction):
    points = np.random.default_rng(0).uniform([-2, -1, 0], [2, 1, 1], (200, 3))
    intrinsics = views.intrinsics_for(320, 200)
    view = views.framing_camera(points, np.array(direction), np.array([0, 0.0, 1]), intrinsics, fill=0.8)
    u, v, z = raster.project(view, points).T
    assert (z > 0).all()
    share = max(np.abs(u - 159.5).max() / 160, np.abs(v - 99.5).max() / 100)
    assert share == pytest.approx(0.8, abs=0.02)


def scene() -> tuple[ObjectMap, np.ndarray]:
    rng = np.random.default_rng(3)
    objects = []
    for i, x in enumerate((-0.8, 0.8)):
        box = trimesh.creation.box(extents=(0.6, 0.6, 0.8))
        vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 0.1)[:2]
        vertices = vertices + np.array([x, 0, 0.4])
        T = np.eye(4)
        T[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
        T[:3, 3] = [x, 0, 0.4]
        objects.append(
            MappedObject(
                i + 1,
                "box",
                "mapped",
                T_world_object=T,
                scale=np.ones(3),
                code=np.zeros(2),
                vertices=vertices,
                faces=faces,
                vertex_sigma=0.03 * vertices[:, 2],
            )
        )
    floor = np.concatenate([rng.uniform(-1.5, 1.5, (20000, 2)), np.zeros((20000, 1))], axis=1)
    wall = np.stack([rng.uniform(-1.5, 1.5, 20000), np.full(20000, -0.9), rng.uniform(0, 0.9, 20000)], axis=1)
    lost = MappedObject(7, "box", "failed", "seen in 12 pixels")
    return ObjectMap("two boxes", (*objects, lost), UP), np.concatenate([floor, wall])


def opened(path) -> np.ndarray:
    assert path.stat().st_size < 1_000_000
    return np.asarray(Image.open(path).convert("RGB"), float) / 255


def test_the_map_picture_shows_meshes_over_the_cloud(tmp_path):
    object_map, points = scene()
    path = tmp_path / "pictures" / "map.png"
    map_picture(object_map, points, None, path, width=800)
    picture = opened(path)
    assert picture.shape[1] == 800
    saturation = picture.max(axis=2) - picture.min(axis=2)
    panels = saturation[:, :375], saturation[:, 375:745]
    for panel in panels:  # the meshes are coloured, the cloud is grey
        assert 0.04 < (panel[70:] > 0.15).mean() < 0.6
    grey = (saturation < 0.02) & (picture.mean(axis=2) < 0.97) & (picture.mean(axis=2) > 0.5)
    assert grey[70:, :745].mean() > 0.1
    above = panels[1][70:]
    assert (above[:, :185] > 0.15).sum() == pytest.approx((above[:, 185:] > 0.15).sum(), rel=0.2)


def test_the_map_picture_takes_colours_objects_without_sigma_and_no_points(tmp_path):
    object_map, points = scene()
    plain = [
        MappedObject(**{**vars(entry), "vertex_sigma": None})
        for entry in object_map.objects
        if entry.faces is not None
    ]
    path = tmp_path / "map.png"
    map_picture(ObjectMap("plain", tuple(plain), UP), np.empty((0, 3)), None, path, width=400)
    assert opened(path).std() > 0.02
    colors = np.tile([0.9, 0.2, 0.2], (len(points), 1))
    points[:5] = np.nan
    map_picture(object_map, points, colors, path, width=400)
    picture = opened(path)
    assert ((picture[..., 0] - picture[..., 1]) > 0.2).mean() > 0.05


def test_what_cannot_be_drawn_is_named(tmp_path):
    object_map, points = scene()
    lost = object_map.objects[2]
    with pytest.raises(MapError, match="nothing to draw"):
        map_picture(ObjectMap("room", (lost,), UP), points, None, tmp_path / "map.png")
    with pytest.raises(MapError, match="as many RGB colours"):
        map_picture(object_map, points, points[:3], tmp_path / "map.png")
    assert not list(tmp_path.iterdir())


def test_names_with_dollars_are_drawn_as_they_are(tmp_path):
    name = r"rooms$\1_$2"
    sheet, (axis,), bar = figure.panels(400, (300, 200), 1, name, None)
    figure.show(axis, np.ones((200, 300, 3)), name)
    figure.label(axis, [name], np.array([[150.0, 100.0]]))
    figure.finish(sheet, bar, None, tmp_path / "a.png")
    assert opened(tmp_path / "a.png").std() > 0.01


def test_labels_stay_in_their_panel_beside_each_other():
    (axis,) = figure.panels(400, (300, 200), 1, "x", None)[1]
    figure.label(axis, [f"chair {i}" for i in range(6)], np.tile([150.0, 50.0], (6, 1)))
    heights = sorted(text.get_position()[1] for text in axis.texts)
    assert heights[0] > 10
    assert heights[-1] < 190
    assert min(np.diff(heights)) > 20


def test_a_picture_of_noise_is_made_small_enough(tmp_path):
    sheet, axes, bar = figure.panels(1600, (720, 576), 2, "noise", None)
    noise = np.random.default_rng(0).uniform(size=(576, 720, 3))
    for axis in axes:
        figure.show(axis, noise, "noise")
    figure.finish(sheet, bar, None, tmp_path / "noise.png")
    assert opened(tmp_path / "noise.png").std() > 0.02
