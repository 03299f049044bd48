"""First guesses: boxes about gravity in any world, and the ranking that finds a chair's heading."""

from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.state import ObjectState
from objgraph.errors import InitialisationError
from objgraph.graph import GraphConfig
from objgraph.initialise import (
    InitialisationConfig,
    gravity_box,
    guesses,
    mean_extents,
    rank,
    single_object_graph,
    smallest_heading,
)
from objgraph.sampling import ObjectView, SamplingConfig, observe
from tests.toys import ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=150, hits=80, free=80)
SIZE = np.array([0.9, 0.4, 1.3])
"""Of a made-up cuboid: level, level, up."""

ups = st.sampled_from([(0, 0, 1), (0, -1, 0), (0, 1, 0), (1, 0, 0), (0, 0, -2), (0.3, -0.8, 0.5)])
angles = st.floats(-np.pi, np.pi)


def cuboid(count: int = 4000) -> np.ndarray:
    """Points that fill a cuboid about the origin."""
    return np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3)) * SIZE


def turned(points: np.ndarray, up, angle: float) -> np.ndarray:
    """A z-up world's points in a world of another up, turned about it."""
    up = np.asarray(up, float) / np.linalg.norm(up)
    axis = np.cross(UP, up)
    if np.linalg.norm(axis) > 1e-9:
        axis /= np.linalg.norm(axis)
    else:
        axis = np.array([1.0, 0.0, 0.0])
    onto = gtsam.Rot3.AxisAngle(axis, float(np.arccos(np.clip(UP @ up, -1, 1))))
    return points @ (gtsam.Rot3.AxisAngle(up, angle).matrix() @ onto.matrix()).T


def modulo(angle: float, period: float) -> float:
    """Distance of an angle from the next multiple of the period."""
    return float(np.abs((angle + period / 2) % period - period / 2))


@settings(max_examples=30)
@given(ups, angles)
def test_the_smallest_heading_turns_with_the_points(up, angle):
    start = smallest_heading(turned(cuboid(), up, 0.0), np.array(up, float))
    after = smallest_heading(turned(cuboid(), up, angle), np.array(up, float))
    assert modulo(after - start - angle, np.pi / 2) < np.radians(4)


@settings(max_examples=30)
@given(ups, angles, st.tuples(*[st.floats(-5, 5)] * 3))
def test_the_box_at_the_smallest_heading_is_the_cuboid(up, angle, offset):
    points = turned(cuboid(), up, angle) + np.array(offset)
    up = np.array(up, float)
    box = gravity_box(points, up, smallest_heading(points, up))
    np.testing.assert_allclose(box.R_world_object @ box.R_world_object.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(box.R_world_object) == pytest.approx(1)
    np.testing.assert_allclose(box.R_world_object[:, 1], up / np.linalg.norm(up), atol=1e-12)
    np.testing.assert_allclose(np.sort(box.size[[0, 2]]), np.sort(SIZE[:2]), rtol=0.06)
    assert box.size[1] == pytest.approx(SIZE[2], rel=0.04)
    np.testing.assert_allclose(box.centre_world, offset, atol=0.03)


@settings(max_examples=30)
@given(ups, angles, angles)
def test_any_heading_s_box_holds_the_points(up, angle, heading):
    points, up = turned(cuboid(), up, angle), np.array(up, float)
    box = gravity_box(points, up, heading)
    inside = np.abs((points - box.centre_world) @ box.R_world_object) <= 0.5 * box.size + 1e-9
    assert inside.all(axis=1).mean() > 0.93
    again = gravity_box(points, up, heading + 2 * np.pi)
    np.testing.assert_allclose(again.R_world_object, box.R_world_object, atol=1e-9)


@settings(max_examples=30)
@given(ups, angles, st.floats(0.0, 0.75), st.floats(-5, 5))
def test_the_box_stands_on_a_near_floor(up, heading, gap, height):
    up = np.array(up, float) / np.linalg.norm(up)
    points = turned(cuboid(), up, 0.0) + height * up
    seen = gravity_box(points, up, heading)
    bottom = seen.centre_world @ up - 0.5 * seen.size[1]
    floor = float(bottom - gap)
    box = gravity_box(points, up, heading, floor, floor_reach=0.8)
    assert box.centre_world @ up - 0.5 * box.size[1] == pytest.approx(floor, abs=1e-9)
    assert box.centre_world @ up + 0.5 * box.size[1] == pytest.approx(bottom + seen.size[1], abs=1e-9)
    np.testing.assert_allclose(box.size[[0, 2]], seen.size[[0, 2]])
    far = gravity_box(points, up, heading, floor, floor_reach=gap - 1e-3)
    np.testing.assert_allclose(far.size, seen.size)
    np.testing.assert_allclose(far.centre_world, seen.centre_world)


def test_stray_points_do_not_move_the_box():
    points = np.concatenate([cuboid(), np.random.default_rng(1).uniform(-9, 9, (15, 3))])
    box = gravity_box(points, UP, smallest_heading(points, UP))
    np.testing.assert_allclose(np.sort(box.size), np.sort(SIZE), rtol=0.08)


def test_a_flat_cloud_has_a_box_all_the_same():
    box = gravity_box(cuboid() * [1, 0, 1], UP, 0.0)
    assert (box.size >= 0.05).all()


def view_of(points: np.ndarray) -> ObjectView:
    """A view that is nothing but its points."""
    view = observe(toy_frame([toy_state()], 0.3), 1, SAMPLING)
    return replace(
        view, T_world_camera=gtsam.Pose3(), points_camera=points, points_sigma=np.ones(len(points))
    )


@pytest.mark.parametrize("counts", [(), (9,), (4, 5)])
def test_too_few_points_are_an_error(counts):
    views = [view_of(np.ones((count, 3))) for count in counts]
    with pytest.raises(InitialisationError, match="too few to place an object"):
        guesses(toy_prior(), views, UP, None, InitialisationConfig())


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (0.3, -0.8, 0.5)])
@pytest.mark.parametrize("floor", [None, -1.0])
def test_guesses_are_upright_evenly_turned_and_about_the_points(up, floor):
    up = np.array(up, float) / np.linalg.norm(up)
    points = turned(cuboid(), up, 0.4)
    config = InitialisationConfig(headings=6)
    states = guesses(toy_prior(), [view_of(points[:2000]), view_of(points[2000:])], up, floor, config)
    assert len(states) == 6
    for state, after in pairwise(states):
        R = state.T_world_object.rotation()
        np.testing.assert_allclose(R.matrix()[:, 1], up, atol=1e-9)
        between = gtsam.Rot3.Logmap(R.between(after.T_world_object.rotation()))
        np.testing.assert_allclose(between, [0, np.pi / 3, 0], atol=1e-9)
    low, high = -1.0 if floor == -1.0 else -0.65, 0.65
    for state in states:
        np.testing.assert_allclose(state.code, toy_prior().code_mean)
        centre = state.T_world_object.translation()
        assert centre @ up == pytest.approx(0.5 * (low + high), abs=0.03)
        np.testing.assert_allclose(centre - (centre @ up) * up, 0, atol=0.05)
        if floor is not None:  # then the height is the object's, and the mean shape is made as high
            height = state.scale[1] * mean_extents(toy_prior())[1]
            assert height == pytest.approx(high - low, rel=0.2)


def test_a_guess_s_size_stays_in_the_category_s_range():
    prior = toy_prior()
    for factor in (0.01, 30.0):
        for state in guesses(prior, [view_of(cuboid() * factor)], UP, None, InitialisationConfig()):
            deviation = state.log_scale.mean() - np.log(prior.size_mean)
            assert abs(deviation) <= 2.5 * prior.size_log_sigma + 0.15 + 1e-9


def into(state: ObjectState, views, T: gtsam.Pose3) -> tuple[ObjectState, list[ObjectView]]:
    """The same scene told in another world."""
    moved = [replace(view, T_world_camera=T.compose(view.T_world_camera)) for view in views]
    return replace(state, T_world_object=T.compose(state.T_world_object)), moved


Y_DOWN = gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.array([0.5, 0.2, -0.3]))
"""Takes a z-up world to one whose y points down."""


@pytest.mark.parametrize(
    ("heading", "T"),
    [(0.4, gtsam.Pose3()), (2.2, gtsam.Pose3()), (-1.3, Y_DOWN)],
    ids=["z up", "z up, turned", "y down"],
)
def test_ranking_keeps_the_chair_s_heading(heading, T):
    state = toy_state(heading)
    views = [observe(toy_frame([state], a, str(i), seed=i), 1, SAMPLING) for i, a in enumerate((0.3, 2.0))]
    state, views = into(state, views, T)
    up = T.rotation().matrix() @ UP
    floor = float(T.translation() @ up)
    config = InitialisationConfig()
    states = guesses(toy_prior(), views, up, floor, config)
    best, problems = rank(toy_prior(), views, states, up, config, GraphConfig())
    assert len(problems) == len(states) == config.headings
    assert 1 <= len(best) <= config.keep
    errors = [
        np.linalg.norm(
            gtsam.Rot3.Logmap(state.T_world_object.rotation().between(b.T_world_object.rotation()))
        )
        for b in best
    ]
    assert errors[0] < np.radians(10)
    # the others are other headings, not the same one again
    assert all(error > 0.25 for error in errors[1:])


def test_ranking_is_cheapest_first_and_drops_what_cannot_be_solved():
    state = toy_state()
    views = [observe(toy_frame([state], 0.3), 1, SAMPLING)]
    lost = replace(state, code=np.full(4, np.nan))
    back = replace(
        state, T_world_object=state.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3)))
    )
    best, _ = rank(toy_prior(), views, [lost, back, state], UP, InitialisationConfig(keep=3), GraphConfig())
    turn = [
        gtsam.Rot3.Logmap(state.T_world_object.rotation().between(b.T_world_object.rotation())) for b in best
    ]
    assert np.linalg.norm(turn[0]) < 0.2
    assert len(best) <= 2
    with pytest.raises(InitialisationError, match=r"none of 2 guesses could be solved: .*o0"):
        rank(toy_prior(), views, [lost, lost], UP, InitialisationConfig(), GraphConfig())


def test_the_mean_shape_s_extents_are_the_prior_s():
    widths = 2 * np.array([0.26, 0.41, 0.26])
    np.testing.assert_allclose(mean_extents(toy_prior()), widths, atol=0.03)
    stretched = replace(toy_prior(), code_mean=np.array([1.0, 0.0, 0.0, 0.0]))
    assert mean_extents(stretched)[0] == pytest.approx(widths[0] + 0.1, abs=0.03)


def test_the_graph_of_one_object_has_its_views_and_priors():
    state = toy_state()
    view = observe(toy_frame([state], 0.3), 1, SAMPLING)
    objects = single_object_graph(toy_prior(), state, [view, view], UP, GraphConfig())
    assert objects.graph.size() == 3 + 2 * 2
    assert objects.objects[0].views == ["0", "0"]
    assert isinstance(objects.objects[0].prior.decoder, ToyDecoder)
    assert len(objects.problems()) == 1
