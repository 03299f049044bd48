"""Trajectories: the TUM format there and back, association by time, and the absolute error."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from objgraph.datasets.trajectory import (
    Trajectory,
    absolute_trajectory_error,
    associate,
    interpolate,
    read_labelled_poses,
    read_tum,
    write_tum,
)
from objgraph.errors import DatasetError, EvaluationError


def rigid(rotation_vector=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    T[:3, 3] = translation
    return T


def random_trajectory(count=30, seed=0):
    rng = np.random.default_rng(seed)
    poses = [rigid(rng.normal(size=3), rng.normal(size=3)) for _ in range(count)]
    return Trajectory(np.arange(count) / 10, np.array(poses))


def moved(T, trajectory, delay=0.0):
    return Trajectory(trajectory.timestamps + delay, T @ trajectory.T_world_camera)


# half turns and the identity are where a quaternion's sign and its small parts are lost
turns = st.one_of(
    st.lists(st.floats(-10, 10), min_size=3, max_size=3),
    st.sampled_from([[np.pi, 0, 0], [0, np.pi - 1e-9, 0], [0, 0, -np.pi], [0, 0, 0], [1e-9, 0, 0]]),
)
places = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3)
moments = st.lists(st.floats(-1e3, 2e9), min_size=1, max_size=6, unique=True).map(sorted)


@given(moments, st.data())
def test_what_is_written_is_read(tmp_path_factory, times, data):
    poses = [rigid(data.draw(turns), data.draw(places)) for _ in times]
    path = tmp_path_factory.mktemp("there and back") / "new" / "trajectory.txt"
    write_tum(path, Trajectory(np.array(times), np.array(poses)))
    read = read_tum(path)
    np.testing.assert_array_equal(read.timestamps, times)
    np.testing.assert_array_equal(read.positions, [T[:3, 3] for T in poses])
    np.testing.assert_allclose(read.T_world_camera, poses, rtol=0, atol=1e-14 * 1e6)
    np.testing.assert_allclose(read.T_world_camera[:, :3, :3], [T[:3, :3] for T in poses], atol=1e-14)
    numbers = np.loadtxt(path, ndmin=2)  # as other programs read it
    assert numbers.shape == (len(times), 8)
    np.testing.assert_allclose(np.linalg.norm(numbers[:, 4:], axis=1), 1)
    assert (numbers[:, 7] >= 0).all()
    assert [item.name for item in path.parent.iterdir()] == ["trajectory.txt"]


def test_the_formats_order_signs_and_comments(tmp_path):
    path = tmp_path / "trajectory.txt"
    half = np.sqrt(0.5)
    path.write_text(
        "# timestamp tx ty tz qx qy qz qw\n\n"
        f"2.0, 4, 5, 6, 0, 0, {-half:.4f}, {-half:.4f}\n"  # 90 degrees about z, to four digits, with commas
        f"1.0 1 2 3 0 0 {half} {half}\r\n"
    )
    trajectory = read_tum(path)
    assert len(trajectory) == 2
    np.testing.assert_array_equal(trajectory.timestamps, [1, 2])
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3], [4, 5, 6]])
    for T in trajectory.T_world_camera:
        np.testing.assert_allclose(T[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_a_byte_order_mark_is_no_word(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text("0.5 1 2 3 0 0 0 1\n1.5 1 2 3 0 0 0 1\n", encoding="utf-8-sig")
    assert list(read_labelled_poses(path)) == ["0.5", "1.5"]
    path.write_text("# a comment\n0.5 1 2 3 0 0 0 1\n", encoding="utf-8-sig")
    assert list(read_labelled_poses(path)) == ["0.5"]


def test_of_equal_moments_the_first_counts(tmp_path, caplog):
    path = tmp_path / "trajectory.txt"
    path.write_text("1.5 1 0 0 0 0 0 1\n1.5 2 0 0 0 0 0 1\n1.50 3 0 0 0 0 0 1\n")
    assert list(read_labelled_poses(path)) == ["1.5", "1.50"]
    assert "1.5 begins several lines" in caplog.text
    np.testing.assert_array_equal(read_tum(path).positions, [[1, 0, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no pose"),
        ("# only words\n", "holds no pose"),
        ("1 2 3 4 0 0 0\n", "line 1: 7 words instead of the 8"),
        ("#\n1 2 3 4 0 0 0 1 9\n", "line 2: 9 words instead of the 8"),
        ("1 2 3 4 0 0 0 one\n", "line 1: could not convert"),
        ("1 nan 3 4 0 0 0 1\n", "line 1: the pose holds NaN or infinity; delete the line"),
        ("1 2 3 4 0 0 0 0\n", "line 1: the quaternion's length is 0 instead of 1"),
        ("1 2 3 4 0 0 1 1\n", "line 1: the quaternion's length is 1.41 instead of 1"),
        ("a 2 3 4 0 0 0 1\n", "a line begins with no timestamp"),
        ("nan 2 3 4 0 0 0 1\n", "timestamps must be numbers"),
    ],
)
def test_what_is_no_trajectory_is_named(tmp_path, text, message):
    path = tmp_path / "trajectory.txt"
    path.write_text(text)
    with pytest.raises(DatasetError, match=message) as caught:
        read_tum(path)
    assert str(path) in str(caught.value)


def test_files_that_cannot_be(tmp_path):
    with pytest.raises(DatasetError, match=r"absent\.txt: cannot be read"):
        read_tum(tmp_path / "absent.txt")
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match="cannot be written"):
        write_tum(tmp_path / "file" / "trajectory.txt", random_trajectory(2))
    (tmp_path / "folder").mkdir()
    with pytest.raises(DatasetError, match="cannot be written"):
        write_tum(tmp_path / "folder", random_trajectory(2))
    assert sorted(item.name for item in tmp_path.iterdir()) == ["file", "folder"]


@pytest.mark.parametrize(
    ("timestamps", "poses", "message"),
    [
        ([0, 1], [np.eye(4)], "2 timestamps and 1 poses"),
        ([0, 0], [np.eye(4)] * 2, "each later than the one before"),
        ([1, 0], [np.eye(4)] * 2, "each later than the one before"),
        ([0, np.nan], [np.eye(4)] * 2, "each later than the one before"),
        ([0, 1], [np.eye(4), 2 * np.eye(4)], "pose 1 is no rigid transform"),
        ([0, 1], [np.diag([1.0, 1, -1, 1]), np.eye(4)], "pose 0 is no rigid transform"),
        ([0], [np.full((4, 4), np.nan)], "pose 0 is no rigid transform"),
    ],
)
def test_what_is_no_trajectory_in_memory(timestamps, poses, message):
    with pytest.raises(DatasetError, match=message):
        Trajectory(np.array(timestamps, float), np.array(poses))


def test_an_empty_trajectory_may_be_but_not_be_measured():
    empty = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    assert len(empty) == 0
    with pytest.raises(EvaluationError, match="0 poses"):
        absolute_trajectory_error(empty, random_trajectory())


def test_closest_moments_are_paired_first_and_once():
    first, second = np.array([0.0, 1.0, 1.4, 5.0]), np.array([5.1, 1.3, 0.2, 9.0])
    np.testing.assert_array_equal(associate(first, second, 0.35), [[0, 2], [2, 1], [3, 0]])
    np.testing.assert_array_equal(associate(first, second, 0.15), [[2, 1], [3, 0]])
    assert associate(first, np.zeros(0)).shape == (0, 2)


@given(
    st.lists(st.integers(0, 100), max_size=12), st.lists(st.integers(0, 100), max_size=12), st.integers(0, 20)
)
def test_association_is_one_to_one_and_leaves_no_free_pair(first, second, limit):
    a, b = np.array(first, float), np.array(second, float)
    pairs = associate(a, b, limit)
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
    assert (np.abs(a[pairs[:, 0]] - b[pairs[:, 1]]) <= limit).all()
    free = set(range(len(a))) - set(pairs[:, 0]), set(range(len(b))) - set(pairs[:, 1])
    assert not any(abs(a[i] - b[k]) <= limit for i in free[0] for k in free[1])


@given(turns, st.lists(st.floats(-100, 100), min_size=3, max_size=3))
def test_a_moved_trajectory_is_aligned_to_nothing(turn, place):
    truth = random_trajectory()
    estimate = moved(rigid(turn, place), truth, delay=0.015)
    assert absolute_trajectory_error(estimate, truth, "rigid") < 1e-9
    assume(np.linalg.norm(place) > 20)
    assert absolute_trajectory_error(estimate, truth) > 1


def test_the_error_is_the_root_mean_square():
    truth = random_trajectory(4)
    poses = truth.T_world_camera.copy()
    poses[:, :3, 3] += [[3, 4, 0], [0, 0, 0], [0, 5, 0], [0, 0, 0]]
    assert absolute_trajectory_error(Trajectory(truth.timestamps, poses), truth) == pytest.approx(
        np.sqrt(12.5)
    )


def test_neither_scale_nor_mirror_is_aligned_away():
    truth = random_trajectory()
    centred = truth.positions - truth.positions.mean(axis=0)
    for change in (np.diag([1.5, 1.5, 1.5]), np.diag([1.0, 1, -1])):
        poses = truth.T_world_camera.copy()
        poses[:, :3, 3] = centred @ change
        error = absolute_trajectory_error(Trajectory(truth.timestamps, poses), truth, "rigid")
        assert error > 0.3
    poses[:, :3, 3] = 1.5 * centred
    error = absolute_trajectory_error(Trajectory(truth.timestamps, poses), truth, "rigid")
    assert error == pytest.approx(0.5 * np.sqrt(np.mean(np.sum(centred**2, axis=1))))


@pytest.mark.parametrize("flatness", [1.0, 0.0])
def test_the_alignment_is_the_best_there_is(flatness):
    rng = np.random.default_rng(1)
    truth = random_trajectory(12, seed=2)
    poses = truth.T_world_camera.copy()
    poses[:, 2, 3] *= flatness  # a camera on wheels moves in a plane
    truth = Trajectory(truth.timestamps, poses)
    poses = (rigid([0.3, -2, 0.5], [1, 2, 3]) @ poses).copy()
    poses[:, :3, 3] += 0.2 * rng.normal(size=(12, 3))
    estimate = Trajectory(truth.timestamps, poses)
    error = absolute_trajectory_error(estimate, truth, "rigid")

    def other(x):
        return absolute_trajectory_error(moved(rigid(x[:3], x[3:]), estimate), truth)

    found = min(minimize(other, rng.normal(size=6), method="BFGS").fun for _ in range(6))
    assert error <= found + 1e-9
    assert error == pytest.approx(found, abs=1e-4)


def test_what_cannot_be_compared_says_why():
    truth = random_trajectory()
    with pytest.raises(EvaluationError, match=r"0 poses .* within 0\.02 s .* clocks"):
        absolute_trajectory_error(moved(np.eye(4), truth, delay=0.03), truth)
    assert absolute_trajectory_error(moved(np.eye(4), truth, 0.03), truth, max_difference=0.04) == 0
    two = Trajectory(truth.timestamps[:2], truth.T_world_camera[:2])
    assert absolute_trajectory_error(two, truth) == 0
    with pytest.raises(EvaluationError, match=r"2 poses .* 3 are needed"):
        absolute_trajectory_error(two, truth, "rigid")
    with pytest.raises(EvaluationError, match="no alignment 'scale'"):
        absolute_trajectory_error(truth, truth, "scale")  # pyright: ignore[reportArgumentType]


@given(st.integers(0, 2**32 - 1), st.lists(st.floats(-0.5, 3.5), max_size=8))
def test_a_pose_between_two_divides_their_way_and_turn_as_their_time(seed, times):
    trajectory = random_trajectory(31, seed)
    times = np.array([*times, *trajectory.timestamps, 0.05])
    found = interpolate(trajectory, times, 0.1)
    inside = (times >= -1e-4) & (times <= 3.0 + 1e-4)
    np.testing.assert_array_equal(np.isfinite(found).all(axis=(1, 2)), inside)
    np.testing.assert_allclose(found[-32:-1], trajectory.T_world_camera, atol=1e-9)
    before = np.clip(np.searchsorted(trajectory.timestamps, times) - 1, 0, 29)
    for T, time, k in zip(found[inside], times[inside], before[inside], strict=True):
        first, second = trajectory.T_world_camera[k], trajectory.T_world_camera[k + 1]
        share = (time - trajectory.timestamps[k]) / 0.1
        if min(share, 1 - share) > 0.002:  # nearer ones are taken as they are
            np.testing.assert_allclose(
                T[:3, 3], (1 - share) * first[:3, 3] + share * second[:3, 3], atol=1e-9
            )
            whole = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude()
            part = Rotation.from_matrix(first[:3, :3].T @ T[:3, :3]).magnitude()
            assert part == pytest.approx(share * whole, abs=1e-6)


def test_poses_far_in_time_are_none_and_text_is_rounded():
    trajectory = Trajectory(np.array([1.0, 2.0]), np.array([rigid(), rigid(translation=(1, 0, 0))]))
    assert np.isnan(interpolate(trajectory, np.array([1.5]), 0.4)).all()
    np.testing.assert_allclose(interpolate(trajectory, np.array([1.5]), 0.6)[0, 0, 3], 0.5)
    np.testing.assert_array_equal(
        interpolate(trajectory, np.array([2.00005]), 0)[0], rigid(translation=(1, 0, 0))
    )
    assert np.isnan(interpolate(trajectory, np.array([2.001, 0.999]), 9)).all()
