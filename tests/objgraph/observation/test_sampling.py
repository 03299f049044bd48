"""What `observe` makes of a frame: points and rays that agree with the images, and errors that name the culprit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from objgraph.errors import ObservationError
from objgraph.observation.frames import Frame, Intrinsics
from objgraph.observation.sampling import (
    SamplingConfig,
    SensorNoise,
    _draw,
    independent_shares,
    observe,
    thinned,
)
from tests.toys import ToyDecoder, toy_frame, toy_state

CAMERA = Intrinsics(80.0, 80.0, 31.5, 23.5, 64, 48)
BOX, WALL, BLOCKER = 2.0, 3.0, 1.0
ROWS, COLUMNS = slice(12, 36), slice(20, 44)


def flat_frame(**changes) -> Frame:
    """A square target at 2 m before a wall at 3 m."""
    depth = np.full((48, 64), WALL)
    depth[ROWS, COLUMNS] = BOX
    instances = np.zeros((48, 64), int)
    instances[ROWS, COLUMNS] = 7
    return replace(Frame("f12", depth, CAMERA, np.eye(4), instances), **changes)


def pixels(directions) -> tuple[np.ndarray, np.ndarray]:
    """(v, u) of ray directions."""
    u, v = np.round(CAMERA.project(directions)).astype(int).T
    return v, u


def with_depth(value, where=np.s_[:, :]) -> Frame:
    frame = flat_frame()
    depth = frame.depth.copy()
    depth[where] = value
    return replace(frame, depth=depth)


def masked(where) -> Frame:
    instances = np.zeros((48, 64), int)
    instances[where] = 7
    return flat_frame(instances=instances)


def posed(T) -> Frame:
    return flat_frame(T_world_camera=np.asarray(T, float))


BAD = {
    "empty mask": (masked(np.s_[:0]), "mask is empty"),
    "one pixel": (masked(np.s_[20, 30]), "1 mask pixels"),
    "whole picture": (masked(np.s_[:, :]), "covers the whole picture"),
    "depth of zeros": (with_depth(0.0), "0 mask pixels have depth"),
    "depth of NaN": (with_depth(np.nan), "0 mask pixels have depth"),
    "depth of infinity": (with_depth(np.inf), "0 mask pixels have depth"),
    "negative depth": (with_depth(-2.0), "0 mask pixels have depth"),
    "millimetres": (flat_frame(depth=1000 * flat_frame().depth), "divide by 1000"),
    "flying pixels": (
        with_depth(np.random.default_rng(0).uniform(1, 9, (24, 24)), (ROWS, COLUMNS)),
        "mask pixels have a steady depth",
    ),
    "a pose of a national grid": (
        posed(np.eye(4) + 5.3e6 * np.eye(4, k=3)),
        "more than 1000 km from the world's origin: move the origin",
    ),
    "pose of NaN": (posed(np.full((4, 4), np.nan)), "not a finite 4x4"),
    "pose of -inf": (posed(np.full((4, 4), -np.inf)), "not a finite 4x4"),
    "scaled pose": (posed(np.diag([2.0, 2.0, 2.0, 1.0])), "no rigid motion"),
    "mirrored pose": (posed(np.diag([-1.0, 1.0, 1.0, 1.0])), "no rigid motion"),
    "pose of zeros": (posed(np.zeros((4, 4))), "no rigid motion"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_frame_is_an_error_that_names_it(case):
    frame, message = BAD[case]
    with pytest.raises(ObservationError, match=message) as caught:
        observe(frame, 7)
    assert "frame f12" in str(caught.value)
    assert "object 7" in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T_world_camera": np.eye(4)[:3]}, r"T_world_camera has shape \(3, 4\)"),
        ({"depth": np.full((48, 64), "far")}, "depth is an array of"),
        ({"depth": torch.zeros(48, 64, requires_grad=True)}, "depth is no array of numbers"),
        ({"instances": np.zeros((48, 64))}, "instances is an array of float64; its entries must be whole"),
        ({"instances": np.full((48, 64), 10**12)}, "an instance id is above"),
        ({"color": np.zeros((48, 64))}, "color is an array of float64"),
        (
            {"color": np.zeros((48, 64, 3), np.uint16)},
            "color is an array of uint16; its entries must be of 8",
        ),
        ({"intrinsics": None}, "intrinsics must be of type Intrinsics, not NoneType"),
    ],
)
def test_what_is_no_image_or_pose_is_refused_with_the_frame_s_name(changes, message):
    with pytest.raises(ObservationError, match=f"frame f12: {message}"):
        flat_frame(**changes)


@pytest.mark.parametrize("focal", [0.0, -80.0, np.nan, "wide", None])
def test_a_camera_without_a_focal_length_is_refused(focal):
    with pytest.raises(ObservationError, match=r"Intrinsics\.fx must be"):
        replace(CAMERA, fx=focal)


def test_an_object_that_no_pixel_names_is_an_error():
    with pytest.raises(ObservationError, match="object 8: the mask is empty"):
        observe(flat_frame(), 8)


def test_intrinsics_of_another_resolution_are_an_error():
    with pytest.raises(ObservationError, match=r"f12.*64x48.*128x96"):
        flat_frame(intrinsics=replace(CAMERA, width=128, height=96))


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf, -1.0, 60.0])
def test_pixels_without_depth_are_never_used(bad):
    frame = with_depth(bad, np.s_[::3, :])
    depth = np.where(np.isfinite(frame.depth) & (frame.depth > 0) & (frame.depth < 20), frame.depth, 0)
    view = observe(frame, 7)
    v, u = pixels(view.rays.directions_camera)
    assert (v % 3 > 0).all()
    hit = view.rays.hit
    np.testing.assert_array_equal(view.rays.depth[hit], depth[v, u][hit])
    np.testing.assert_array_equal(view.rays.end[~hit], depth[v, u][~hit])
    np.testing.assert_allclose(view.points_camera[:, 2], BOX)


def test_rays_say_what_the_images_say():
    frame = toy_frame([toy_state()], 0.7)
    view = observe(frame, 1)
    rays = view.rays
    u, v = np.round(frame.intrinsics.project(rays.directions_camera)).astype(int).T
    hit = rays.hit
    assert 0 < hit.sum() <= SamplingConfig().hits
    assert 0 < (~hit).sum() <= SamplingConfig().free
    np.testing.assert_array_equal(frame.instances[v, u] == 1, hit)
    np.testing.assert_array_equal(rays.depth[hit], frame.depth[v, u][hit])
    np.testing.assert_array_equal(rays.end[~hit], frame.depth[v, u][~hit])
    assert (rays.end[hit] > rays.depth[hit]).all()
    np.testing.assert_allclose(rays.directions_camera[:, 2], 1)
    # beside the object its own depth is the outline's, which lies within the object
    on_object = frame.depth[frame.instances == 1]
    assert ((rays.depth >= on_object.min()) & (rays.depth <= on_object.max())).all()


def test_background_and_occluder():
    frame = flat_frame()
    depth = frame.depth.copy()
    depth[:, 44:] = BLOCKER
    rays = observe(replace(frame, depth=depth), 7).rays
    _, u = pixels(rays.directions_camera)
    free = ~rays.hit
    # the blocker ends its rays before the object: they say nothing of it, and none comes from there at all
    assert (rays.end[free] >= BOX).all()
    assert (u[free] < 44).all()
    np.testing.assert_array_equal(rays.end[free], WALL)
    np.testing.assert_array_equal(rays.depth, BOX)
    # a hit at the blocker's edge still ends on the object
    assert (u[rays.hit] >= 42).any()
    assert (rays.end[rays.hit] > BOX).all()


def test_a_blocker_among_the_object_s_depths_ends_its_rays_there():
    """Over a deep object an occluder may stand behind its nearest and before its farthest point."""
    frame = flat_frame()
    depth = frame.depth.copy()
    depth[ROWS, COLUMNS] = np.linspace(2.0, 2.6, 24)[:, None]
    depth[:, 44:] = 2.3
    rays = observe(replace(frame, depth=depth), 7).rays
    v, u = pixels(rays.directions_camera)
    blocked = ~rays.hit & (u >= 44)
    assert blocked.any()
    np.testing.assert_array_equal(rays.end[blocked], 2.3)
    assert (rays.end[blocked & (v > 26)] < rays.depth[blocked & (v > 26)]).all()
    assert (rays.end[rays.hit] > rays.depth[rays.hit]).all()


def test_sigmas_are_the_sensor_s_and_the_outline_s():
    config = SamplingConfig(noise=SensorNoise(0.01, 0.002), mask_sigma=2.0)
    view = observe(flat_frame(), 7, config)
    sensor = 0.01 + 0.002 * BOX**2
    np.testing.assert_allclose(view.points_sigma, sensor)
    np.testing.assert_allclose(view.rays.sigma, np.hypot(sensor, 2.0 * BOX / CAMERA.fx))
    oblong = replace(
        CAMERA, fx=CAMERA.fx * 4, fy=CAMERA.fy / 4
    )  # rolled by a quarter turn it would be the other way round
    np.testing.assert_allclose(observe(flat_frame(intrinsics=oblong), 7, config).rays.sigma, view.rays.sigma)


def test_the_counts_of_the_configuration_are_kept():
    none = observe(flat_frame(), 7, SamplingConfig(free=0))
    assert none.rays.hit.all()
    view = observe(flat_frame(), 7, SamplingConfig(points=30, hits=20, free=10))
    assert (len(view.points_camera), view.rays.hit.sum(), (~view.rays.hit).sum()) == (30, 20, 10)
    few = observe(flat_frame(), 7, SamplingConfig(points=10_000, hits=10_000, free=10_000))
    assert len(few.points_camera) == few.rays.hit.sum() <= 24**2
    thin = view.thinned(8, 5)
    assert (len(thin.points_camera), len(thin.rays.depth), thin.correlation_length) == (
        8,
        5,
        view.correlation_length,
    )
    assert {tuple(p) for p in thin.points_camera} <= {tuple(p) for p in view.points_camera}


def test_points_are_drawn_evenly():
    """Of a flat mask nine squares have a ninth of the points each, to within what lies across their borders."""
    for seed in range(5):
        view = observe(flat_frame(), 7, SamplingConfig(points=144, hits=144), seed=seed)
        for points in (view.points_camera, view.thinned(72, 72, seed).points_camera):
            third = np.linspace(points[:, 0].min() - 1e-9, points[:, 0].max() + 1e-9, 4)
            down = np.linspace(points[:, 1].min() - 1e-9, points[:, 1].max() + 1e-9, 4)
            counts = np.histogram2d(points[:, 0], points[:, 1], (third, down))[0]
            assert np.abs(counts - len(points) / 9).max() <= 5  # drawn at random it is more


@given(
    hnp.arrays(float, st.integers(2, 60), elements=st.floats(1e-3, 1.0)),
    st.integers(1, 20),
    st.integers(0, 99),
)
def test_a_place_is_drawn_as_often_as_it_is_heavy(weight, count, seed):
    """Over many draws, where none is so heavy that it is due twice in one."""
    order = np.random.default_rng(seed).permutation(len(weight))
    if count >= len(weight):
        assert sorted(_draw(np.random.default_rng(0), weight, count, order)) == list(range(len(weight)))
        return
    rng, drawn, due = np.random.default_rng(seed), np.zeros(len(weight)), count * weight / weight.sum()
    for _ in range(1000):
        found = _draw(rng, weight, count, order)
        assert len(set(found)) == len(found) <= count
        drawn[found] += 1e-3
    np.testing.assert_allclose(drawn, due.clip(max=1.0), atol=0.09)  # 5.7 deviations


@pytest.mark.parametrize(("views", "each"), [(1, 12), (3, 4), (5, 2), (40, 1)])
def test_views_share_the_points_and_keep_one_at_least(views, each):
    view = observe(flat_frame(), 7)
    found = thinned([view] * views, 12, 12)
    assert [len(thin.points_camera) for thin in found] == [each] * views
    assert [len(thin.rays.depth) for thin in found] == [each] * views


def test_the_seed_alone_decides():
    frame = toy_frame([toy_state()], 0.7)
    one, same, other = observe(frame, 1, seed=3), observe(frame, 1, seed=3), observe(frame, 1, seed=4)
    np.testing.assert_array_equal(one.points_camera, same.points_camera)
    np.testing.assert_array_equal(one.rays.directions_camera, same.rays.directions_camera)
    assert not np.array_equal(one.points_camera, other.points_camera)


@pytest.mark.parametrize("azimuth", [0.0, 2.0, 4.0])
def test_points_lie_on_the_object(azimuth):
    state = toy_state(code=(0.6, -0.5, 0.3, 1.0))
    view = observe(toy_frame([state], azimuth, noise=0.0), 1)
    p_object = torch.as_tensor(state.to_object(view.points_world), dtype=torch.float32)
    sdf = ToyDecoder()(p_object, torch.as_tensor(state.code, dtype=torch.float32)[None])
    # scales are within 5 % of one metre a unit
    assert sdf.abs().max() < 1e-4


def test_a_nearly_rigid_pose_is_made_rigid():
    rng = np.random.default_rng(0)
    T = np.eye(4)
    T[:3, :3] += rng.uniform(-2e-3, 2e-3, (3, 3))
    R = observe(posed(T), 7).T_world_camera.rotation().matrix()
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R, T[:3, :3], atol=5e-3)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.integers(2, 8), st.integers(1, 3))
def test_patches_do_not_depend_on_how_many_pixels_are_sampled(seed, more, size):
    rng = np.random.default_rng(seed)
    cells = np.stack(np.meshgrid(*[np.arange(size)] * 3), axis=-1).reshape(-1, 3)
    base = (cells[:, None] + rng.uniform(0.05, 0.95, (len(cells), 40, 3))).reshape(-1, 3) * 0.2
    repeated = np.repeat(base, more, axis=0)
    for points in (base, repeated):
        assert independent_shares(points, 0.2, most=0.5).sum() == pytest.approx(size**3)


def test_patches_of_a_view_do_not_depend_on_its_resolution():
    def at(factor):
        camera = Intrinsics(
            80.0 * factor, 80.0 * factor, 32 * factor - 0.5, 24 * factor - 0.5, 64 * factor, 48 * factor
        )
        big = np.ones((factor, factor), int)
        frame = flat_frame()
        return Frame(
            "f", np.kron(frame.depth, big), camera, np.eye(4), np.kron(frame.instances, big)
        )  # fmt: skip

    counts = [observe(at(factor), 7).points_share.sum() for factor in (1, 3, 6)]
    assert max(counts) - min(counts) <= 0.2 * min(counts)
    assert counts[0] == pytest.approx((BOX * 24 / 80 / 0.2) ** 2, rel=0.8)


def test_a_stray_point_is_no_patch():
    points = np.concatenate([np.full((500, 3), 0.1), np.full((1, 3), 5.1)])
    share = independent_shares(points, 0.2, most=0.5)
    assert share[:500].sum() == pytest.approx(1)
    assert share[500] == 0.5


def test_hits_and_free_rays_are_counted_apart():
    view = observe(flat_frame(), 7)
    hit = view.rays.hit
    for group, most in ((hit, 0.25), (~hit, 1.0)):
        at = view.rays.directions_camera[group] * view.rays.depth[group, None]
        np.testing.assert_allclose(
            view.rays_share[group], independent_shares(at, view.correlation_length, most)
        )


def test_what_is_seen_past_the_object_is_not_of_it():
    """A mask with slats holds pixels of the wall behind; a part of the object behind an occluder stays."""
    frame = flat_frame()
    v, u = np.nonzero(frame.instances == 7)
    depth = frame.depth.copy()
    gaps = np.random.default_rng(0).permutation(len(v))[: len(v) // 8]
    depth[v[gaps], u[gaps]] = BOX + 1.0
    view = observe(replace(frame, depth=depth), 7)
    assert (view.points_camera[:, 2] < BOX + 0.1).all()
    assert len(view.points_camera) > 100
    assert (view.rays.depth < BOX + 0.1).all()
    halves = frame.instances.copy()
    halves[:, 30:34] = 0
    both = observe(replace(frame, instances=halves), 7, SamplingConfig(points=10_000))
    assert len(both.points_camera) == np.count_nonzero(halves == 7)
