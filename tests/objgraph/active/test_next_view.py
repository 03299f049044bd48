"""Next best views: which cameras there are, what they see, and what seeing it is worth."""

import json
from dataclasses import replace

import gtsam
import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from factors.state import ObjectState
from objgraph.active.cameras import looking_at, reachable, sphere
from objgraph.active.from_map import targets_from_map
from objgraph.active.next_view import (
    NextViewConfig,
    expected_information,
    known_precision,
    next_views,
    visible,
)
from objgraph.active.target import Target, target
from objgraph.cli.next_view import NextViewCommand, run_next_view
from objgraph.covariance.labelled import ObjectCovariance
from objgraph.covariance.sides import SideMisfit
from objgraph.errors import ActiveVisionError, MapError
from objgraph.graph.builder import ObjectBuilder
from objgraph.maps.mapped_object import MappedObject, PriorReference
from objgraph.maps.object_map import ObjectMap
from objgraph.observation.sampling import SamplingConfig, independent_shares, observe
from objgraph.show.next_view import sphere_picture
from tests.toys import INTRINSICS, toy_frame, toy_mesh, toy_picture, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
CONFIG = NextViewConfig(INTRINSICS)
ALONE = replace(CONFIG, sides=SideMisfit(marginals=1.0, seen=1e-3, unseen=1e-9))
"""Sides are known by the marginals alone, seen or not."""
SAMPLING = SamplingConfig(points=200, hits=100, free=100)
D = 13


def seen_once(azimuth: float = 0.3) -> tuple[ObjectState, ObjectCovariance]:
    """A toy chair where it is, with what one picture says of it."""
    state = toy_state()
    view = observe(toy_frame([state], azimuth), 1, SAMPLING)
    single = ObjectBuilder(up_world=UP, floor=0.0).alone(toy_prior(), state, [view])
    return state, single.marginals()


@pytest.fixture(scope="module")
def chair() -> Target:
    return target("chair 1", toy_prior(), *seen_once(), resolution=48)


def scene_of(*meshes: tuple[np.ndarray, np.ndarray]) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    for vertices, faces in meshes:
        scene.add_triangles(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32))
    return scene


def about(chair: Target, count: int = 24) -> list[gtsam.Pose3]:
    return sphere(chair.centre, 2.2, UP, count, (10.0, 50.0))


@given(
    st.integers(1, 40), st.floats(0.3, 5), st.floats(-80, 60), st.floats(0, 25),
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
)  # fmt: skip
def test_cameras_on_a_sphere_look_at_its_middle_from_between_the_elevations(count, radius, low, more, up):
    centre, up = np.array([0.3, -1.0, 2.0]), np.array(up) / np.linalg.norm(up)
    cameras = sphere(centre, radius, up, count, (low, low + more))
    assert len(cameras) == count
    for camera in cameras:
        R, away = camera.rotation().matrix(), camera.translation() - centre
        np.testing.assert_allclose(np.linalg.norm(away), radius, rtol=1e-9)
        np.testing.assert_allclose(R[:, 2], -away / radius, atol=1e-9)
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) > 0
        assert abs(R[:, 0] @ up) < 1e-9  # level
        assert R[:, 1] @ up <= 1e-9  # y is down
        assert low - 1e-6 <= np.degrees(np.arcsin(np.clip(away @ up / radius, -1, 1))) <= low + more + 1e-6


def test_cameras_are_spread_evenly_over_the_zone():
    eyes = np.array([c.translation() for c in sphere(np.zeros(3), 1.0, UP, 600, (0, 60))])
    heights = np.histogram(eyes[:, 2], bins=6, range=(0, np.sin(np.pi / 3)))[0]
    bearings = np.histogram(np.arctan2(eyes[:, 1], eyes[:, 0]), bins=6, range=(-np.pi, np.pi))[0]
    assert np.abs(heights - 100).max() <= 1
    assert np.abs(bearings - 100).max() <= 5


def test_what_is_no_camera_or_out_of_reach_is_refused():
    for radius, count, elevations in (
        (1.0, 0, (0, 9)),
        (0.0, 3, (0, 9)),
        (1.0, 3, (50, 10)),
        (1.0, 3, (0, 95)),
    ):
        with pytest.raises(ActiveVisionError, match="sphere"):
            sphere(np.zeros(3), radius, UP, count, elevations)
    with pytest.raises(ActiveVisionError, match="cannot look at"):
        looking_at(np.ones(3), np.ones(3), UP)
    cameras = sphere(np.zeros(3), 1.0, UP, 10)
    east = reachable(cameras, lambda T: bool(T.translation()[0] > 0))
    assert 0 < len(east) < 10
    with pytest.raises(ActiveVisionError, match="none of 10 cameras"):
        reachable(cameras, lambda _: False)
    down = looking_at(np.array([0, 0, 2.0]), np.zeros(3), UP)
    np.testing.assert_allclose(down.rotation().matrix()[:, 2], [0, 0, -1])


def test_what_is_seen_is_what_a_picture_shows(chair):
    """Of the points that the prediction calls visible nearly all have the object's own depth in a rendered picture."""
    state = toy_state()
    scene = scene_of((chair.vertices, chair.faces))
    for camera in about(chair, 6):
        frame = toy_picture([state], camera.matrix(), noise=0.0)
        seen = visible(chair, camera, scene, CONFIG)
        p_camera = (chair.points - camera.translation()) @ camera.rotation().matrix()
        u, v = np.round(INTRINSICS.project(p_camera)).astype(int).T
        shown = (frame.instances[v, u] == 1) & (np.abs(frame.depth[v, u] - p_camera[:, 2]) < 0.03)
        assert shown[seen].mean() > 0.93
        assert seen[shown].mean() > 0.8
        assert 0.15 < seen.mean() < 0.7


def test_nothing_is_seen_from_behind_a_wall_too_far_or_beside_the_picture(chair):
    camera = about(chair, 5)[2]
    T = camera.matrix()
    wall = trimesh.creation.box(
        (3.0, 3.0, 0.02), transform=T @ trimesh.transformations.translation_matrix([0, 0, 0.8])
    )
    scene = scene_of((chair.vertices, chair.faces), (np.asarray(wall.vertices), np.asarray(wall.faces)))
    open_scene = scene_of((chair.vertices, chair.faces))
    assert visible(chair, camera, open_scene, CONFIG).any()
    assert not visible(chair, camera, scene, CONFIG).any()
    assert not visible(chair, camera, open_scene, replace(CONFIG, far=1.0)).any()
    away = camera.compose(gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.zeros(3)))
    assert not visible(chair, away, open_scene, CONFIG).any()
    (blind,) = next_views([chair], [away], CONFIG)
    assert blind.total() == blind.total("pose") == blind.total("surface") == 0.0


def test_expected_information_is_that_of_the_3d_and_2d_factors(chair):
    """Within a factor of two, in every direction that the view tells more of than was known."""
    state, covariance = seen_once()
    scene = scene_of((chair.vertices, chair.faces))
    root = np.linalg.cholesky(covariance.matrix)
    for camera in about(chair, 4):
        view = observe(toy_picture([state], camera.matrix(), seed=3), 1, SAMPLING)
        single = ObjectBuilder(up_world=UP).alone(toy_prior(), state, [view])
        rows = [factor.rows(single.values).jacobian.numpy() for factor in single.factors]
        true = root.T @ sum(J.T @ J for J in rows) @ root
        expected = (
            root.T @ expected_information(chair, camera, visible(chair, camera, scene, CONFIG), CONFIG) @ root
        )
        gains = [0.5 * np.linalg.slogdet(np.eye(D) + each)[1] for each in (expected, true)]
        assert gains[0] == pytest.approx(gains[1], rel=0.35)


def test_the_gain_is_that_of_the_information_added(chair):
    camera = about(chair, 3)[1]
    (view,) = next_views([chair], [camera], ALONE)
    gain = view.objects["chair 1"]
    seen = visible(chair, camera, scene_of((chair.vertices, chair.faces)), CONFIG)
    added = expected_information(chair, camera, seen, CONFIG)
    before, after = np.linalg.inv(chair.information), np.linalg.inv(chair.information + added)
    assert gain.information == pytest.approx(
        0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1])
    )
    assert gain.pose == pytest.approx(
        0.5 * (np.linalg.slogdet(before[:9, :9])[1] - np.linalg.slogdet(after[:9, :9])[1])
    )
    spread = [np.mean([J @ C @ J for J in chair.jacobian]) for C in (before, after)]
    assert gain.surface == pytest.approx(spread[0] - spread[1])
    assert gain.seen == seen.mean()
    np.testing.assert_allclose(chair.surface_sigma**2, [J @ before @ J for J in chair.jacobian])
    looser = target("chair 1", replace(toy_prior(), surface_misfit=3.0), *seen_once(), resolution=48)
    (of_looser,) = next_views([looser], [camera], ALONE)
    assert of_looser.objects["chair 1"].surface == pytest.approx(3 * gain.surface)
    assert of_looser.objects["chair 1"].information == pytest.approx(gain.information)
    np.testing.assert_allclose(looser.surface_sigma, np.sqrt(3) * chair.surface_sigma)
    assert np.linalg.eigvalsh(added).min() > -1e-6 * np.linalg.eigvalsh(added).max()


@pytest.mark.parametrize("criterion", ["information", "surface"])
def test_the_other_side_is_worth_more_than_the_one_that_was_seen(criterion):
    """After one picture, a camera opposite to it is expected to tell more than one beside it."""
    for azimuth in (0.3, 2.2, 4.0):
        known = target("chair", toy_prior(), *seen_once(azimuth))

        def at(bearing: float, known: Target = known) -> gtsam.Pose3:
            away = np.array([2.2 * np.cos(bearing), 2.2 * np.sin(bearing), 1.0])
            return looking_at(known.centre + away, known.centre, UP)

        known = replace(known, seen_from=(at(azimuth),))
        best, *_ = next_views([known], [at(azimuth), at(azimuth + np.pi)], CONFIG, criterion=criterion)
        assert best.T_world_camera.equals(at(azimuth + np.pi), 1e-9)


def test_views_share_what_the_decoder_cannot_make(chair):
    """Against the generalised least squares of one point's measurements, whose errors are noise and one in common."""
    first, second, third = about(chair, 3)
    scene = scene_of((chair.vertices, chair.faces))
    seen = [visible(chair, camera, scene, CONFIG) for camera in (first, second, third)]
    known = replace(chair, seen_from=(first, second))
    precision = known_precision(known, scene, CONFIG)
    assert not precision[~(seen[0] | seen[1])].any()

    def told(point: int, views: list[int]) -> float:
        """Information on the point's signed distance from some of the views, those that see it."""
        cameras = [(first, second, third)[i] for i in views if seen[i][point]]
        depths = [camera.transformTo(known.points[point])[2] for camera in cameras]
        noise = np.array([CONFIG.noise(np.array([depth]))[0] for depth in depths])
        covariance = np.diag(noise**2) + known.residual[point] ** 2
        return float(np.linalg.inv(covariance).sum()) if depths else 0.0

    jacobian = known.jacobian[seen[2]]
    p_camera = np.array([third.transformTo(p) for p in known.points[seen[2]]])
    share = independent_shares(p_camera, CONFIG.correlation_length, most=0.25)
    more = np.array([told(i, [0, 1, 2]) - told(i, [0, 1]) for i in np.flatnonzero(seen[2]).tolist()])
    assert (seen[2] & seen[0] & seen[1]).any()
    assert (seen[2] & ~seen[0] & ~seen[1]).any()
    np.testing.assert_allclose(
        expected_information(known, third, seen[2], CONFIG, precision),
        2 * (jacobian * (share * more)[:, None]).T @ jacobian,
        rtol=1e-9, atol=1e-6,
    )  # fmt: skip


@given(st.floats(0.3, 6.0))
def test_the_more_views_there_were_the_less_one_tells(chair, azimuth):
    """... and no view takes information away."""
    away = np.array([2.2 * np.cos(azimuth), 2.2 * np.sin(azimuth), 1.0])
    camera = looking_at(chair.centre + away, chair.centre, UP)
    gains = [
        next_views([replace(chair, seen_from=(camera,) * count)], [camera], CONFIG)[0].total("information")
        for count in range(4)
    ]
    assert all(np.diff(gains) < 0)
    assert gains[-1] > 0


def test_of_two_objects_gains_are_added_and_the_best_comes_first(chair):
    other_state = replace(
        toy_state(2.0), T_world_object=gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.array([1.6, 0.2, 0.42]))
    )
    other = target("chair 2", toy_prior(), other_state, seen_once()[1])
    views = next_views([chair, other], about(chair), CONFIG)
    totals = [view.total() for view in views]
    assert totals == sorted(totals, reverse=True)
    assert totals[0] > totals[-1]
    for view in views:
        assert set(view.objects) == {"chair 1", "chair 2"}
        assert view.total() == pytest.approx(sum(gain.corners for gain in view.objects.values()))
        assert view.total("surface") == pytest.approx(sum(gain.surface for gain in view.objects.values()))
    hidden = next_views([chair], about(chair), CONFIG, others=[(other.vertices, other.faces)])
    alone = next_views([chair], about(chair), CONFIG)
    assert sum(v.objects["chair 1"].seen for v in hidden) < sum(v.objects["chair 1"].seen for v in alone)


def test_objects_that_cannot_be_asked_about_are_refused(chair):
    state, covariance = seen_once()
    with pytest.raises(ActiveVisionError, match="9 axes, its state has 13"):
        target("chair", toy_prior(), state, ObjectCovariance.diagonal(np.ones(9), "x"))
    singular = covariance.matrix.copy()
    singular[0] = singular[:, 0] = 0.0
    with pytest.raises(ActiveVisionError, match="not positive definite"):
        target("chair", toy_prior(), state, ObjectCovariance.of(singular, "x"))
    with pytest.raises(ActiveVisionError, match="0 cameras"):
        next_views([chair], [])
    with pytest.raises(ActiveVisionError, match="0 objects"):
        next_views([], about(chair))


def toy_map(category: str = "chair", **changes) -> ObjectMap:
    state, covariance = seen_once()
    mesh = toy_mesh(state.code)
    given = {
        "T_world_object": state.T_world_object.matrix(),
        "scale": state.scale,
        "code": state.code,
        "covariance": covariance.rigid,
        "code_sigma": covariance.sigma[9:],
        "joint_covariance": covariance.matrix,
        "prior": PriorReference("chair", "toy"),
        "vertices": state.to_world(np.asarray(mesh.vertices)),
        "faces": np.asarray(mesh.faces),
    }
    entries = (
        MappedObject(1, category, "mapped", **(given | changes)),
        MappedObject(2, "chair", "failed", "seen in 3 pixels"),
    )
    return ObjectMap("room", entries, UP)


def test_a_maps_objects_are_known_by_their_own_prior(chair):
    (found,) = targets_from_map(toy_map(), priors=[toy_prior()])
    assert found.name == "chair 1"
    np.testing.assert_allclose(found.information, chair.information, rtol=1e-6, atol=1e-6)
    assert found.seen_from == ()
    camera = about(chair, 1)[0]
    (found,) = targets_from_map(toy_map(views=("0",), cameras=camera.matrix()[None]), priors=[toy_prior()])
    (seen_from,) = found.seen_from
    state = seen_once()[0]
    other = replace(
        state, T_world_object=state.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3)))
    )
    turned = np.zeros((4, D))
    turned[2] = state.local_coordinates(other)
    doubtful = toy_map(turns=np.array([0.7, 0.0, 0.3, 0.0]), turned=turned)
    (found,) = targets_from_map(doubtful, priors=[toy_prior()])
    (heading,) = found.others
    assert (found.probability, heading.probability) == (0.7, 0.3)
    np.testing.assert_allclose(heading.vertices, other.to_world(state.to_object(found.vertices)), atol=1e-6)
    assert seen_from.equals(camera, 1e-12)
    with pytest.raises(ActiveVisionError, match=r"objects \[2\] are not mapped; mapped are \[1\]"):
        targets_from_map(toy_map(), [2], [toy_prior()])
    with pytest.raises(MapError, match="mapped with prior chair toy, the one at hand"):
        targets_from_map(toy_map())
    with pytest.raises(MapError, match="no joint covariance"):
        targets_from_map(toy_map(joint_covariance=None), priors=[toy_prior()])


def test_an_object_that_is_named_twice_is_asked_about_once():
    (found,) = targets_from_map(toy_map(), [1, 1], [toy_prior()])
    assert found.name == "chair 1"


def test_the_command_lists_the_best_views_and_writes_them(tmp_path, monkeypatch):
    toy_map().save(tmp_path / "map")
    monkeypatch.setattr("objgraph.cli.next_view.load_prior_file", lambda _: toy_prior())
    command = NextViewCommand(
        tmp_path / "map" / "map.json",
        candidates=12,
        out=tmp_path / "out",
        priors=(tmp_path / "toy.safetensors",),
    )
    console = Console(width=140, record=True)
    views = run_next_view(command, console)
    text = console.export_text()
    assert "chair 1" in text
    assert len(views) == 12
    document = json.loads((tmp_path / "out" / "next_views.json").read_text())
    assert [view["gain"] for view in document["views"]] == [view.total() for view in views]
    np.testing.assert_allclose(document["views"][0]["T_world_camera"], views[0].T_world_camera.matrix())
    assert (tmp_path / "out" / "next_view_chair_1.png").stat().st_size > 10_000
    assert "corners' mean square error (cm²)" in " ".join(text.split())
    surface = run_next_view(replace(command, criterion="surface", out=None), console)
    assert "(cm²)" in (text := console.export_text().replace("\n", " "))
    assert f"{1e4 * surface[0].total('surface'):.3g}" in text


def test_two_objects_of_one_name_are_refused(chair):
    with pytest.raises(ActiveVisionError, match=f"several objects are called {chair.name}"):
        next_views([chair, chair], about(chair), CONFIG)


def test_the_picture_marks_where_it_was_seen_from(tmp_path, chair):
    views = next_views([chair], about(chair), CONFIG)
    bare, marked = tmp_path / "a.png", tmp_path / "b.png"
    sphere_picture(chair, chair.surface_sigma, views, UP, bare)
    seen = replace(chair, seen_from=(looking_at(np.array([2.0, 0.0, 1.0]), chair.centre, UP),))
    sphere_picture(seen, chair.surface_sigma, views, UP, marked)
    assert bare.read_bytes() != marked.read_bytes()


def test_the_picture_has_one_scale_however_far_off_the_earlier_views_are(tmp_path, chair, monkeypatch):
    drawn = []
    monkeypatch.setattr("objgraph.show.next_view.finish", lambda figure, *_: drawn.append(figure))
    far = replace(chair, seen_from=(looking_at(np.array([9.0, 0.0, 1.0]), chair.centre, UP),))
    sphere_picture(
        far, chair.surface_sigma, next_views([chair], about(chair), CONFIG), UP, tmp_path / "a.png"
    )
    for axis in drawn[0].axes[:2]:
        edges = np.ptp([axis.get_xlim(), axis.get_ylim(), axis.get_zlim()], axis=1)
        np.testing.assert_allclose(edges / edges[0], axis.get_box_aspect() / axis.get_box_aspect()[0])
