"""Nothing below the floor: rays, derivatives, and what the factor must not say."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.base import Annealing
from factors.errors import FactorError, NotFiniteError
from factors.floor import FloorFactor, camera_from_pose, floor_share
from factors.state import CAMERA_DOF, POSE_DOF, ObjectKeys, ObjectState
from tests.factors.conftest import SphereDecoder, assert_gtsam_has, make_decoder, random_state
from tests.objgraph.observation.test_gravity_box import ups

KEYS = ObjectKeys.numbered(0)
UP = np.array([0.2, -0.3, 0.9])
UP = UP / np.linalg.norm(UP)


def values_of(state: ObjectState) -> gtsam.Values:
    values = gtsam.Values()
    state.insert(values, KEYS)
    return values


def sunk(seed: int, depth: float) -> tuple[FloorFactor, gtsam.Values]:
    """A leaning lump that reaches under the floor."""
    state = random_state(np.random.default_rng(seed), 0.3)
    factor = FloorFactor(
        KEYS, make_decoder(), UP, float(UP @ state.T_world_object.translation()) - 0.4 + depth
    )
    values = values_of(state)
    factor.refresh(values, Annealing(60.0))
    return factor, values


def jacobian_of(factor: FloorFactor, values: gtsam.Values) -> np.ndarray:
    """Of the decoded SDF, w.r.t. the factor's variables."""
    query = factor.query(values)
    jet = factor.decoder.linearize(query.p_object, query.code[None])
    return factor.sdf_jacobian(query, jet).numpy()


def sdf_at(factor: FloorFactor, values: gtsam.Values) -> np.ndarray:
    query = factor.query(values)
    return factor.decoder(query.p_object, query.code[None]).detach().numpy()


@given(ups, st.floats(-2, 2), st.floats(0.1, 2.0), st.integers(0, 1000))
def test_every_ray_ends_at_the_floor_and_they_cover_the_box(up, floor, scale, seed):
    up = np.array(up, float) / np.linalg.norm(up)
    state = random_state(np.random.default_rng(seed))
    state = ObjectState(state.T_world_object, np.log(scale) * np.ones(3), state.code)
    factor = FloorFactor(KEYS, make_decoder(), up, floor)
    factor.refresh(values_of(state))
    rays, T_world_camera = factor._rays, factor.T_world_camera(values_of(state))
    ends = (rays.directions_camera * rays.end[:, None]) @ T_world_camera.rotation().matrix().T
    ends = ends + T_world_camera.translation()
    np.testing.assert_allclose(ends @ up, floor, atol=1e-9)
    assert not rays.hit.any()
    corners = state.to_world(np.random.default_rng(0).choice([-0.5, 0.5], (20, 3)))
    under = corners - np.outer(corners @ up - floor, up)
    assert np.linalg.norm(under[:, None] - ends[None], axis=2).min(axis=1).max() < 0.08


@pytest.mark.parametrize("seed", range(4))
def test_jacobian_of_the_decoded_points_is_the_numerical_one(seed):
    factor, values = sunk(seed, 0.2)
    jacobian = jacobian_of(factor, values)
    dims, step = factor.dims, 1e-6
    for column in range(sum(dims)):
        delta = np.zeros(sum(dims))
        delta[column] = step
        ends = []
        for sign in (1, -1):
            moved = values_of(ObjectState.from_values(values, KEYS).retract(sign * delta))
            ends.append(sdf_at(factor, moved))
        np.testing.assert_allclose(jacobian[:, column], (ends[0] - ends[1]) / (2 * step), atol=2e-6)


@given(ups, st.integers(0, 1000))
def test_the_camera_follows_as_its_derivative_says(up, seed):
    up = np.array(up, float) / np.linalg.norm(up)
    rng = np.random.default_rng(seed)
    factor, pose = FloorFactor(KEYS, make_decoder(), up, 0.3), random_state(rng).T_world_object
    if abs(up @ pose.rotation().matrix()[:, 0]) > 0.99:  # next to where the heading ends
        return

    def camera(delta: np.ndarray) -> gtsam.Pose3:
        moved = random_state(rng)
        return factor.T_world_camera(values_of(ObjectState(pose.retract(delta), moved.log_scale, moved.code)))

    here = camera(np.zeros(POSE_DOF))
    numerical = np.stack(
        [
            (here.localCoordinates(camera(1e-6 * e)) - here.localCoordinates(camera(-1e-6 * e))) / 2e-6
            for e in np.eye(POSE_DOF)
        ],
        axis=1,
    )
    assert numerical.shape == (CAMERA_DOF, POSE_DOF)
    np.testing.assert_allclose(camera_from_pose(pose, here), numerical, atol=1e-6)


@given(st.integers(0, 4), st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3))
@settings(max_examples=20)
def test_where_on_the_floor_and_which_way_makes_no_difference(seed, east, north, turn):
    factor, values = sunk(seed, 0.3)
    before = factor.loss(values)
    state = ObjectState.from_values(values, KEYS)
    level = np.linalg.svd(UP[None])[2][1:]
    away = gtsam.Pose3(gtsam.Rot3.Expmap(turn * UP), level.T @ [east, north])
    moved = ObjectState(away.compose(state.T_world_object), state.log_scale, state.code)
    assert before > 1
    assert factor.loss(values_of(moved)) == pytest.approx(before, rel=1e-9)
    factor.refresh(values_of(moved), Annealing(60.0))
    assert factor.loss(values_of(moved)) == pytest.approx(before, rel=1e-9)


def test_it_has_no_information_along_the_floor_and_of_the_heading():
    factor, values = sunk(1, 0.2)
    pose = values.atPose3(KEYS.pose)
    rows = factor.rows(values).jacobian.numpy()
    R = pose.rotation().matrix()
    level = np.linalg.svd(UP[None])[2][1:]
    silent = np.zeros((3, rows.shape[1]))
    silent[:2, 3:6] = level @ R
    silent[2, :3] = R.T @ UP  # turns about the vertical through the object's origin
    assert np.linalg.norm(rows) > 1
    np.testing.assert_allclose(rows @ silent.T, 0.0, atol=1e-9 * float(np.linalg.norm(rows)))


def test_a_sphere_in_the_floor_is_pushed_up_and_one_above_is_left_alone():
    decoder = SphereDecoder()
    factor = FloorFactor(KEYS, decoder, np.array([0.0, 0.0, 1.0]), 0.0)

    def at(height: float) -> gtsam.Values:
        pose = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.0, height]))
        return values_of(ObjectState(pose, np.zeros(3), np.zeros(5)))

    costs = []
    for height in (0.2, 0.3, 0.39, 0.45):
        factor.refresh(at(height))
        costs.append(factor.loss(at(height)))
    assert costs[0] > costs[1] > costs[2] > costs[3]
    assert costs[0] > 3
    assert costs[3] == pytest.approx(0.0, abs=1e-3)
    factor.refresh(at(0.3))
    rows = factor.rows(at(0.3))
    gradient = (rows.residual @ rows.jacobian).numpy()
    assert gradient[5] < 0  # up is downhill


def sunk_sphere(radius_m: float, depth_m: float) -> tuple[float, float]:
    """Loss, and what it says of the height, of a sphere of this radius so deep in the floor."""
    factor = FloorFactor(KEYS, SphereDecoder(), np.array([0.0, 0.0, 1.0]), 0.0, half_box=0.42)
    scale = radius_m / 0.4
    pose = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.0, radius_m - depth_m]))
    values = values_of(ObjectState(pose, np.full(3, np.log(scale)), np.zeros(5)))
    factor.refresh(values)
    rows = factor.rows(values)
    return factor.loss(values), float((rows.jacobian[:, 5] ** 2).sum())


def test_what_is_large_weighs_by_the_floor_that_it_is_in_however_far_apart_the_rays_are():
    """A cap of a sphere r, d deep, is pi (2 r - d) d large; no ray counts for more than one where they are far apart."""
    (few, _), (many, _) = sunk_sphere(1.0, 0.2), sunk_sphere(4.0, 0.2)
    apart = 0.42 * np.sqrt(3) * 4.0 / 0.4 / 30
    thinner = (floor_share(apart) / apart**2) / (floor_share(0.08) / 0.08**2)
    assert many / few == pytest.approx(thinner * (8 - 0.2) / (2 - 0.2), rel=0.1)


def test_what_is_far_under_the_floor_is_pushed_up_too():
    shallow, deep = sunk_sphere(0.4, 1.0), sunk_sphere(0.4, 5.0)
    assert deep[0] > shallow[0]


def standing(gap: float, seed: int = 1) -> tuple[FloorFactor, gtsam.Values]:
    """A leaning lump whose feet are this far over the floor, in metres."""
    state = random_state(np.random.default_rng(seed), 0.3)
    foot = state.to_world(np.array([[0.0, -0.4, 0.0]]))[0]
    factor = FloorFactor(KEYS, make_decoder(), UP, float(UP @ foot) - gap, stands=0.4)
    values = values_of(state)
    factor.refresh(values, Annealing(60.0))
    return factor, values


@pytest.mark.parametrize("gap", [-0.05, 0.0, 0.02, 0.3])
def test_standing_adds_cauchys_score_of_the_gap(gap):
    factor, values = standing(gap)
    free = FloorFactor(KEYS, factor.decoder, UP, factor._floor)
    free.refresh(values, Annealing(60.0))
    r = gap / np.hypot(0.01, 0.01)
    assert factor.loss(values) - free.loss(values) == pytest.approx(4.5 * np.log1p(r**2 / 9), abs=1e-6)


@pytest.mark.parametrize("gap", [-0.05, 0.02, 0.3])
def test_the_standing_factors_gradient_is_the_numerical_one(gap):
    factor, values = standing(gap)
    rows = factor.rows(values)
    gradient = (rows.residual @ rows.jacobian).numpy()
    numerical, step = np.zeros(len(gradient)), 1e-5
    for i in range(len(gradient)):
        delta = np.zeros(len(gradient))
        delta[i] = step
        up, down = (
            factor.loss(values_of(ObjectState.from_values(values, KEYS).retract(sign * delta)))
            for sign in (1, -1)
        )
        numerical[i] = (up - down) / (2 * step)
    np.testing.assert_allclose(gradient, numerical, rtol=2e-4, atol=2e-4 * np.abs(numerical).max())
    assert_gtsam_has(factor, values, gradient)


def test_what_is_far_above_the_floor_is_let_go():
    pulls = []
    for gap in (0.01, 0.04, 0.4):
        factor, values = standing(gap)
        rows = factor.rows(values)
        pulls.append(abs(float((rows.residual[-1] * rows.jacobian[-1]).norm())))
    assert pulls[1] > pulls[0]
    assert pulls[2] < 0.3 * pulls[1]


@pytest.mark.parametrize(("up", "floor"), [((0.0, 0.0, 0.0), 0.0), ((0.0, 0.0, 1.0), np.nan)])
def test_a_floor_that_is_none_is_refused(up, floor):
    with pytest.raises(FactorError, match="floor"):
        FloorFactor(KEYS, make_decoder(), np.array(up), floor)


def test_of_what_is_large_the_rays_are_farther_apart_and_no_size_without_end_is_asked_of():
    state = random_state(np.random.default_rng(0), 0.3)
    factor = FloorFactor(KEYS, make_decoder(), UP, 0.0)
    factor.refresh(values_of(ObjectState(state.T_world_object, np.full(3, np.log(1e3)), state.code)))
    assert len(factor._rays.depth) < 20_000
    with pytest.raises(NotFiniteError, match="s0 holds a scale without end"):
        factor.refresh(values_of(ObjectState(state.T_world_object, np.full(3, 800.0), state.code)))


@pytest.mark.parametrize(("spacing", "share"), [(0.02, 0.01), (0.05, 0.0625), (0.2, 1.0), (0.3, 1.0)])
def test_a_floor_s_rays_count_by_the_area_they_stand_for(spacing, share):
    """One measurement a square of the correlation length, twenty centimetres, and never more than one a ray."""
    assert floor_share(spacing) == pytest.approx(share)
