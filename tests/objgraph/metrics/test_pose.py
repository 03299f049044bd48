"""9-DoF pose errors on cases with known answers."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objgraph.errors import EvaluationError
from objgraph.metrics.placed import PlacedMesh
from objgraph.metrics.pose import pose_error, rotation_error

BOX = trimesh.creation.box((0.6, 0.4, 0.69))


def rigid(rotvec=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = translation
    return T


def placed(T=None, scale=(1.0, 1.0, 1.0), vertices: np.ndarray = BOX.vertices, faces=BOX.faces):
    T = np.eye(4) if T is None else T
    return PlacedMesh("a box", T, np.array(scale), np.asarray(vertices), np.asarray(faces))


def yaw(degrees):
    return rigid((0, np.deg2rad(degrees), 0))


def test_translation_is_between_the_box_centres_and_not_the_frames():
    # the same metric box, once with its origin in the middle and once at a corner
    shift = np.array([0.3, 0.2, 0.345])
    truth = placed(rigid(translation=(1, 2, 3)), scale=(2, 2, 2))
    estimate = placed(
        rigid(translation=np.array([1, 2, 3]) - 2 * shift), scale=(2, 2, 2), vertices=BOX.vertices + shift
    )
    error = pose_error(estimate, truth)
    assert error.translation_m == pytest.approx(0, abs=1e-12)
    assert error.scale_pct_max == pytest.approx(0, abs=1e-9)
    moved = placed(rigid(translation=(1.3, 2.4, 3)), scale=(2, 2, 2))
    assert pose_error(moved, truth).translation_m == pytest.approx(0.5)


def test_scale_and_shape_share_the_size():
    # half the shape at twice the scale is the same box
    error = pose_error(placed(scale=(2, 2, 2), vertices=BOX.vertices / 2), placed())
    assert (error.scale_pct, error.scale_pct_max) == pytest.approx((0, 0), abs=1e-9)


def test_scale_is_the_mean_ratio_and_the_worst_axis_stands_beside_it():
    error = pose_error(placed(scale=(1.3, 0.8, 1.05)), placed())
    assert error.scale_pct == pytest.approx(5.0)
    assert error.scale_pct_max == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("symmetry", "degrees", "expected"),
    [
        (1, 180, 180),
        (1, 90, 90),
        (2, 180, 0),
        (2, 90, 90),
        (2, 170, 10),
        (4, 90, 0),
        (4, 270, 0),
        (4, 45, 45),
        (4, -80, 10),
        (3, 120, 0),
        (3, -130, 10),
        (5, 72, 0),
        (0, 33, 0),
        (0, 180, 0),
    ],
)
def test_yaw_counts_modulo_the_symmetry(symmetry, degrees, expected):
    error = pose_error(placed(yaw(degrees)), placed(), symmetry)
    assert error.rotation_deg == pytest.approx(expected, abs=1e-6)


def test_continuous_symmetry_leaves_the_angle_between_the_y_axes():
    tilt = rigid((np.deg2rad(12), 0, 0)) @ yaw(77)
    assert pose_error(placed(tilt), placed(), 0).rotation_deg == pytest.approx(12)
    assert pose_error(placed(tilt), placed(), 1).rotation_deg > 70


@pytest.mark.parametrize(("symmetry", "degrees"), [(4, 90), (4, -93), (0, 80), (0, 260)])
def test_a_quarter_turn_exchanges_the_extents(symmetry, degrees):
    truth = placed(scale=(1.0, 1.0, 2.0))
    # turned by a quarter, its x lies along the truth's z
    long_x = placed(yaw(degrees), scale=(2.0 * 0.69 / 0.6, 1.0, 0.6 / 0.69))
    assert pose_error(long_x, truth, symmetry).scale_pct_max == pytest.approx(0, abs=1e-9)
    assert pose_error(placed(yaw(degrees), scale=(1.0, 1.0, 2.0)), truth, symmetry).scale_pct_max > 40


def test_other_turns_do_not_exchange_them():
    truth = placed(scale=(1.0, 1.0, 2.0))
    for symmetry, degrees in ((2, 180), (4, 180), (0, 180), (3, 120), (3, -120), (5, 72), (6, 60)):
        error = pose_error(placed(yaw(degrees), scale=(1.0, 1.0, 2.0)), truth, symmetry)
        assert (error.rotation_deg, error.scale_pct_max) == pytest.approx((0, 0), abs=1e-9)


vectors = st.tuples(*[st.floats(-2, 2)] * 3)


@settings(max_examples=50, deadline=None)
@given(vectors, vectors, st.integers(0, 6))
def test_the_symmetric_rotation_reported_is_the_best_one(a, b, symmetry):
    R = rigid(a)[:3, :3].T @ rigid(b)[:3, :3]
    angle, turned = rotation_error(R, symmetry)
    candidates = (
        np.linspace(-np.pi, np.pi, 361) if symmetry == 0 else 2 * np.pi * np.arange(symmetry) / symmetry
    )
    errors = [
        Rotation.from_matrix(Rotation.from_rotvec([0, -c, 0]).as_matrix() @ R).magnitude() for c in candidates
    ]
    left = Rotation.from_matrix(Rotation.from_rotvec([0, -turned, 0]).as_matrix() @ R).magnitude()
    assert left == pytest.approx(angle, abs=1e-6)
    assert angle <= min(errors) + 1e-6
    if symmetry == 0:
        assert angle == pytest.approx(np.arccos(np.clip(R[1, 1], -1, 1)), abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(vectors, vectors, vectors, vectors, st.integers(0, 6))
def test_a_common_motion_changes_nothing(rotvec, translation, world_rotvec, world_translation, symmetry):
    T, motion = rigid(rotvec, translation), rigid(world_rotvec, world_translation)
    truth_T = rigid((0.1, -0.4, 0.2), (0.3, 0.1, -0.2))
    before = pose_error(placed(T, (1.1, 0.9, 1.3)), placed(truth_T), symmetry)
    after = pose_error(placed(motion @ T, (1.1, 0.9, 1.3)), placed(motion @ truth_T), symmetry)
    assert after.translation_m == pytest.approx(before.translation_m, abs=1e-9)
    assert after.rotation_deg == pytest.approx(before.rotation_deg, abs=1e-5)
    assert after.scale_pct == pytest.approx(before.scale_pct, abs=1e-9)


def test_small_angles_keep_their_digits():
    angle, _ = rotation_error(rigid((0, 0, 1e-9))[:3, :3], 1)
    assert angle == pytest.approx(1e-9, rel=1e-6)


def test_what_is_no_symmetry_is_refused():
    with pytest.raises(EvaluationError, match="not -1"):
        pose_error(placed(), placed(), -1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"T": np.diag([2.0, 2, 2, 1])}, "not rigid"),
        ({"T": np.diag([1.0, 1, -1, 1])}, "not rigid"),
        ({"T": np.full((4, 4), np.nan)}, "finite 4x4"),
        ({"scale": (1.0, 0.0, 1.0)}, "three positive numbers"),
        ({"scale": (1.0, np.nan, 1.0)}, "three positive numbers"),
        ({"vertices": np.zeros((0, 3)), "faces": np.zeros((0, 3), int)}, "empty"),
        ({"faces": np.zeros((0, 3), int)}, "empty"),
        ({"faces": np.array([[0, 1, 8]])}, "beyond"),
        ({"vertices": BOX.vertices * [1, 0, 1]}, "flat"),
        ({"vertices": np.full((8, 3), np.inf)}, "not finite"),
        ({"vertices": np.zeros((8, 2))}, "must be"),
    ],
)
def test_what_cannot_be_measured_is_refused(change, message):
    with pytest.raises(EvaluationError, match=rf"a box.*{message}"):
        placed(**change)


def test_vertices_without_a_face_are_not_part_of_the_box():
    vertices = np.vstack([BOX.vertices, [[9.0, 9.0, np.nan]]])
    assert placed(vertices=vertices).extents == pytest.approx(BOX.extents)


@pytest.mark.parametrize(
    ("symmetry", "degrees", "expected"),
    [(1, 170, 170), (2, 170, 10), (2, -100, 80), (4, 100, 10), (0, 123, 0)],
)
def test_the_heading_is_modulo_symmetry_and_of_the_up_axis_alone(symmetry, degrees, expected):
    tilted = rigid(rotvec=(np.deg2rad(3), 0, 0))
    assert pose_error(placed(yaw(degrees)), placed(), symmetry).heading_error_deg == pytest.approx(
        expected, abs=1e-6
    )
    error = pose_error(placed(yaw(degrees) @ tilted), placed(), symmetry)
    assert error.heading_error_deg == pytest.approx(expected, abs=0.2)
    assert error.rotation_deg == pytest.approx(np.hypot(expected, 3), abs=0.3) or expected > 20
