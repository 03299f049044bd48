"""What a scan says about a detected car: its returns, what is free beside it, and the road it stands on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.datasets.kitti import load_frame, load_labels
from objgraph.errors import ObservationError
from objgraph.observation.frames import Intrinsics
from objgraph.observation.lidar.frame import Detection, LidarFrame, Picture
from objgraph.observation.lidar.observe import LidarSamplingConfig, observe_lidar
from objgraph.observation.lidar.road import Road, road_under
from objgraph.synthetic.street import ensure_street

UP = np.array([0.0, -1.0, 0.0])


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    return ensure_street(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def frame(street) -> LidarFrame:
    return load_frame(street, "000000")


def labels(street, name="000000"):
    return load_labels(street, name)


def detection_at(x: float, y: float, z: float, number: int = 1) -> Detection:
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])  # faces along the world's z axis
    T[:3, 3] = [x, y, z]
    return Detection(number, "car", T, np.array([1.8, 1.6, 4.0]))


def scan(p_world: np.ndarray, *detections: Detection, picture: Picture | None = None) -> LidarFrame:
    return LidarFrame("made up", np.asarray(p_world, float), np.eye(4), UP, detections, picture)


def wall(depth: float, low=(-0.8, -0.6), high=(0.8, 0.6), step: float = 0.1) -> np.ndarray:
    x, y = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, depth)])


def test_a_cars_returns_are_its_own(street, frame):
    for detection in frame.detections:
        view = observe_lidar(frame, detection, road_under(frame.p_world, UP, detection))
        label = min(labels(street), key=lambda each: np.linalg.norm(each.box.centre - detection.box.centre))
        outside = np.abs((view.points_world - label.box.centre) @ label.box.rotation) - label.size / 2
        assert np.mean(outside.max(axis=1) > 0.08) < 0.03  # four standard deviations of the noise
        rays = view.rays
        ends = rays.directions_camera[rays.hit] * rays.depth[rays.hit, None]
        assert np.allclose(ends, view.points_camera)
        assert not rays.hit.all()
        assert (rays.end[~rays.hit] > 0).all()


def test_no_free_ray_goes_through_the_true_car(street, frame):
    """What is said to be free is: a ray that passes ends behind a surface that it did not meet."""
    for detection in frame.detections:
        view = observe_lidar(frame, detection, road_under(frame.p_world, UP, detection))
        label = min(labels(street), key=lambda each: np.linalg.norm(each.box.centre - detection.box.centre))
        rays = view.rays.take(np.flatnonzero(~view.rays.hit))
        steps = np.linspace(0.0, 1.0, 200)[None, :, None] * rays.end[:, None, None]
        along = (steps * rays.directions_camera[:, None]).reshape(-1, 3)
        T = frame.T_world_lidar
        inner = replace(label.box, extents=label.size * [0.5, 0.4, 0.5])  # well within the body
        deep = inner.contains(along @ T[:3, :3].T + T[:3, 3])
        assert deep.reshape(len(rays.depth), -1).any(axis=1).mean() < 0.05


def test_what_is_before_a_car_says_nothing_and_what_is_behind_is_free():
    car = detection_at(0, 0, 12)
    occluder, own, behind = (
        wall(6.0, (0.3, -0.6), (0.6, 0.6)),
        wall(10.0),
        wall(20.0, (-4, -1.2), (4, 1.2), 0.2),
    )
    view = observe_lidar(scan(np.concatenate([occluder, own, behind]), car), car)
    assert (view.points_camera[:, 2] == 10.0).all()
    free = ~view.rays.hit
    assert free.any()
    assert (view.rays.end[free] == 20.0).all()


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.2, 1.2))
def test_free_rays_are_the_same_wherever_ahead_a_car_is(angle):
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    p_ahead = np.concatenate([wall(10.0), wall(20.0, (-6, -1.2), (6, 1.2), 0.23)])
    car = detection_at(0, 0, 12)
    T = np.eye(4)
    T[:3, :3] = turn
    turned = replace(car, T_world_object=T @ car.T_world_object)
    config = LidarSamplingConfig(free=10_000)
    ends = []
    for frame, detection in ((scan(p_ahead, car), car), (scan(p_ahead @ turn.T, turned), turned)):
        rays = observe_lidar(frame, detection, config=config).rays
        ends.append((rays.directions_camera * rays.end[:, None])[~rays.hit])
    back = ends[1] @ turn
    assert len(back) == len(ends[0]) > 50
    np.testing.assert_allclose(
        back[np.lexsort(back.round(3).T)], ends[0][np.lexsort(ends[0].round(3).T)], atol=1e-6
    )


def test_neighbours_keep_their_own_returns():
    car, other = detection_at(0, 0, 12), detection_at(2.2, 0, 12, number=2)
    own, others = wall(10.2), wall(10.2) + [2.2, 0, 0]
    frame = scan(np.concatenate([own, others]), car, other)
    assert np.abs(observe_lidar(frame, car).points_camera[:, 0]).max() < 0.9
    assert observe_lidar(frame, other).points_camera[:, 0].min() > 1.3


@settings(max_examples=20, deadline=None)
@given(st.sets(st.sampled_from([2, 3, 4])), st.integers(0, 100))
def test_what_is_not_mapped_keeps_its_returns(left_out, seed):
    """Whatever of a car's neighbours is to be mapped, the car's returns are the same."""
    rng = np.random.default_rng(seed)
    car, *others = (detection_at(x, 0, 12, number) for number, x in enumerate((0.0, 2.1, -2.2, 4.1), 1))
    frame = scan(rng.uniform([-5, -0.6, 10.0], [5, 0.6, 11.0], (1500, 3)), car, *others)
    some = replace(
        frame,
        detections=(car, *(each for each in others if each.id not in left_out)),
        others=tuple(each for each in others if each.id in left_out),
    )
    np.testing.assert_array_equal(
        observe_lidar(some, car).points_camera, observe_lidar(frame, car).points_camera
    )
    alone = observe_lidar(replace(frame, detections=(car,)), car).points_camera
    assert np.abs(alone[:, 0]).max() > np.abs(observe_lidar(frame, car).points_camera[:, 0]).max()


def test_the_road_is_no_part_of_the_car():
    car = detection_at(0, 0, 12)
    ground = np.column_stack(
        [*(axis.ravel() for axis in np.meshgrid(np.arange(-4, 4, 0.2), [0.8], np.arange(6, 18, 0.2)))]
    )
    frame = scan(np.concatenate([wall(10.0, (-0.8, -0.7), (0.8, 0.6)), ground]), car)
    road = road_under(frame.p_world, UP, car)
    assert road is not None
    assert road.above(np.array([[0.0, 0.0, 12.0]]))[0] == pytest.approx(0.8, abs=0.01)
    assert observe_lidar(frame, car, road).points_camera[:, 1].max() < 0.7
    assert observe_lidar(frame, car).points_camera[:, 1].max() > 0.7


def test_masks_say_what_is_the_cars():
    car = detection_at(0, 0, 12)
    camera = Intrinsics(100.0, 100.0, 99.5, 99.5, 200, 200)
    ids = np.zeros((200, 200), int)
    ids[:, :100] = 1  # the left half alone
    picture = Picture(np.zeros((200, 200, 3), np.uint8), camera, np.eye(4), ids)
    behind = wall(20.0, (-4, -1.2), (4, 1.2), 0.2)
    view = observe_lidar(scan(np.concatenate([wall(10.0), behind]), car, picture=picture), car)
    assert view.points_camera[:, 0].max() < 0.05
    free = view.rays.directions_camera[~view.rays.hit]
    assert free[:, 0].min() > -0.01  # through the mask it may be a window


def test_a_detection_without_a_mask_is_told_from_an_empty_box():
    """A segmenter that misses a car, or masks that count detections otherwise, leave no return of a full box."""
    car = detection_at(0, 0, 12, number=3)
    camera = Intrinsics(100.0, 100.0, 99.5, 99.5, 200, 200)
    picture = Picture(np.zeros((200, 200, 3), np.uint8), camera, np.eye(4), np.full((200, 200), 2))
    with pytest.raises(
        ObservationError, match=r"car 3: 0 returns are .* on its mask \(pixels of the value 3\)"
    ):
        observe_lidar(scan(wall(10.0), car, picture=picture), car)


def test_a_picture_of_more_than_eight_bits_is_refused():
    camera = Intrinsics(100.0, 100.0, 99.5, 99.5, 200, 200)
    with pytest.raises(ObservationError, match="a picture: color is an array of uint16"):
        Picture(np.zeros((200, 200, 3), np.uint16), camera, np.eye(4))


@pytest.mark.parametrize(
    ("points", "z", "message"),
    [
        (wall(10.0)[:14], 12.0, "14 returns are in the detected box, at least 15 are due"),
        (np.zeros((0, 3)), 12.0, "0 returns"),
        (wall(10.0), -12.0, "not ahead of the LiDAR"),
    ],
)
def test_too_little_is_said(points, z, message):
    car = detection_at(0, 0, z)
    with pytest.raises(ObservationError, match=f"frame made up, car 1: .*{message}"):
        observe_lidar(scan(points, car), car)


def test_a_box_that_is_none_is_refused():
    with pytest.raises(ObservationError, match="edges"):
        replace(detection_at(0, 0, 9), size=np.array([1.0, 0.0, 2.0]))
    with pytest.raises(ObservationError, match="not finite"):
        detection_at(np.nan, 0, 9)
    with pytest.raises(ObservationError, match="two detections have the same id"):
        replace(scan(wall(10.0), detection_at(0, 0, 12)), others=(detection_at(2, 0, 12),))
    with pytest.raises(ObservationError, match="no detection 3; there are: 1"):
        scan(wall(10.0), detection_at(0, 0, 12)).detection(3)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06), st.integers(0, 1000))
def test_a_leaning_road_is_found_among_clutter(across, ahead, seed):
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(-5, 5, 400), rng.uniform(6, 18, 400)
    y = 0.8 + across * x + ahead * (z - 12) + rng.normal(0, 0.02, 400)
    clutter = rng.uniform([-5, -1.0, 6], [5, 0.6, 18], (150, 3))
    road = road_under(np.concatenate([np.column_stack([x, y, z]), clutter]), UP, detection_at(0, 0, 12))
    assert road is not None
    under = np.array([[0.0, 0.8, 12.0]])
    assert abs(road.above(under)[0]) < 0.05
    normal = np.array([across, -1.0, ahead])
    assert road.normal_world @ normal / np.linalg.norm(normal) > np.cos(0.025)


@pytest.mark.parametrize("seed", range(5))
def test_a_road_beside_a_house_of_more_returns_is_found(seed):
    rng = np.random.default_rng(seed)
    x, ahead, high = rng.uniform(-5, 5, 300), rng.uniform(7, 17, 300), rng.uniform(0.2, 0.8, 600)
    road = np.column_stack([x, 0.8 + rng.normal(0, 0.01, 300), ahead])
    house = np.column_stack([4.0 + rng.normal(0, 0.01, 600), high, rng.uniform(7, 17, 600)])
    found = road_under(np.concatenate([road, house]), UP, detection_at(0, 0, 12), seed=seed)
    assert found is not None
    assert abs(found.above(np.array([[0.0, 0.8, 12.0]]))[0]) < 0.05


def test_there_may_be_no_road():
    car = detection_at(0, 0, 12)
    assert road_under(np.zeros((0, 3)), UP, car) is None
    assert road_under(wall(10.0, (-4, -1), (4, 0.7)), UP, car) is None  # a wall is not level
    steep = np.column_stack([np.linspace(-4, 4, 200), np.linspace(-1, 1.6, 200), np.full(200, 16.0)])
    assert road_under(steep, UP, car) is None


def test_few_returns_on_a_strip_leave_the_slope_to_the_prior():
    """A line of returns beside a car does not say how the road leans across it."""
    z = np.linspace(7, 17, 60)
    strip = np.column_stack([np.full(60, 1.5), np.full(60, 0.8), z])
    strip[:, 0] += np.random.default_rng(0).normal(0, 0.2, 60)
    road = road_under(strip, UP, detection_at(0, 0, 12))
    assert road is not None
    assert isinstance(road, Road)
    assert np.degrees(np.arccos(road.normal_world @ UP)) < 1.0


def test_a_seed_gives_the_same_view(frame):
    detection, config = frame.detections[0], LidarSamplingConfig(points=50, free=20)
    a, b = (observe_lidar(frame, detection, None, config, seed=3) for _ in range(2))
    assert np.array_equal(a.points_camera, b.points_camera)
    assert len(a.points_camera) == 50
    assert np.count_nonzero(~a.rays.hit) == 20


@pytest.mark.parametrize("far", [1e300, np.inf, np.nan])
def test_a_return_from_nowhere_changes_nothing(far):
    car = detection_at(0.0, 0.0, 8.0)
    points = np.vstack([wall(7.0), wall(20.0, (-4, -2), (4, 2), 0.4)])
    views = [
        observe_lidar(scan(np.vstack([points, astray]), car), car)
        for astray in (np.zeros((0, 3)), [[far, 0.0, 9.0]])
    ]
    np.testing.assert_array_equal(views[0].points_camera, views[1].points_camera)
