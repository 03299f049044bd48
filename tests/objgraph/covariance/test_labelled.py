"""One labelled type: what it refuses, its blocks, ellipsoids and files, and the same covariance in other coordinates."""

import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from factors.state import ObjectState
from objgraph.covariance.box import BOX_AXES
from objgraph.covariance.frames import in_world, of_xi
from objgraph.covariance.fused import fused
from objgraph.covariance.labelled import RIGID_AXES, LabelledCovariance, ObjectCovariance
from objgraph.errors import CovarianceError

LENGTH = 9 + 4


def some_covariance(seed: int = 0, size: int = LENGTH, source: str = "marginals") -> ObjectCovariance:
    root = np.random.default_rng(seed).normal(size=(size, size)) * 0.05
    return ObjectCovariance.of(root @ root.T, source, "chair 3")


def some_state(seed: int = 0, angle: float | None = None) -> ObjectState:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    angle = rng.uniform(0.01, 3.0) if angle is None else angle
    pose = gtsam.Pose3(gtsam.Rot3.Expmap(angle * axis / np.linalg.norm(axis)), rng.normal(size=3))
    return ObjectState(pose, rng.uniform(-0.4, 0.4, 3), rng.normal(size=LENGTH - 9))


def numerical(of, state: ObjectState, step: float = 1e-6) -> np.ndarray:
    """Derivative of a vector-valued function of a state w.r.t. the state's tangent."""
    size = 9 + len(state.code)
    columns = [
        (of(state.retract(step * e)) - of(state.retract(-step * e))) / (2 * step) for e in np.eye(size)
    ]
    return np.stack(columns, axis=1)


@given(st.integers(0, 1000), st.floats(0, 3.1))
def test_xi_has_the_covariance_of_its_numerical_derivative(seed, angle):
    state, covariance = some_state(seed, angle), some_covariance(seed)
    J = numerical(lambda s: np.concatenate([s.xi_world_object, s.code]), state)
    found = of_xi(covariance, state)
    np.testing.assert_allclose(found.matrix, J @ covariance.matrix @ J.T, atol=1e-6)
    assert found.axes[:3] == tuple(f"t_{a} [m, world frame]" for a in "xyz")
    assert (found.source, found.subject) == ("marginals", "chair 3")


@given(st.integers(0, 1000))
def test_in_the_world_it_is_that_of_a_turn_about_the_objects_origin_and_of_its_place(seed):
    state, covariance = some_state(seed), some_covariance(seed)

    def world(moved: ObjectState) -> np.ndarray:
        turned = moved.T_world_object.rotation().compose(state.T_world_object.rotation().inverse())
        place = moved.T_world_object.translation()
        return np.concatenate([gtsam.Rot3.Logmap(turned), place, moved.log_scale, moved.code])

    J = numerical(world, state)
    found = in_world(covariance, state.T_world_object.rotation())
    np.testing.assert_allclose(found.matrix, J @ covariance.matrix @ J.T, atol=1e-7)
    np.testing.assert_allclose(
        np.linalg.eigvalsh(found.matrix), np.linalg.eigvalsh(covariance.matrix), atol=1e-12
    )


@given(st.integers(0, 1000))
def test_a_box_in_the_world_turns_about_its_centre(seed):
    rng, step = np.random.default_rng(seed), 1e-6
    T = some_state(seed).T_world_object
    root = 0.05 * rng.normal(size=(9, 9))
    covariance = LabelledCovariance(root @ root.T, BOX_AXES, "calibrated", "chair 3")

    def world(tangent: np.ndarray) -> np.ndarray:
        moved = T.retract(tangent[:6])
        turn = gtsam.Rot3.Logmap(moved.rotation().compose(T.rotation().inverse()))
        return np.concatenate([turn, moved.translation(), tangent[6:]])

    J = np.stack([(world(step * e) - world(-step * e)) / (2 * step) for e in np.eye(9)], axis=1)
    found = in_world(covariance, T.rotation())
    np.testing.assert_allclose(found.matrix, J @ covariance.matrix @ J.T, atol=1e-7)
    assert found.axes[3] == "centre_x [m, world frame]"
    assert found.axes[6:] == BOX_AXES[6:]
    with pytest.raises(CovarianceError, match="neither an object's nor a box's"):
        in_world(covariance.block("centre"), T.rotation())


def test_blocks_are_found_by_their_labels():
    covariance = some_covariance()
    np.testing.assert_array_equal(covariance.block("translation").matrix, covariance.matrix[3:6, 3:6])
    np.testing.assert_array_equal(covariance.block("code").matrix, covariance.code)
    np.testing.assert_array_equal(covariance.rigid, covariance.matrix[:9, :9])
    with pytest.raises(CovarianceError, match="'colour'"):
        covariance.block("colour")


def test_an_ellipsoid_holds_the_share_that_was_asked_for():
    covariance = some_covariance().block("translation")
    directions, radii = covariance.ellipsoid(0.9)
    assert (np.diff(radii) <= 0).all()
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance.matrix, 40_000)
    inside = np.square(draws @ directions / radii).sum(axis=1) <= 1
    assert inside.mean() == pytest.approx(0.9, abs=0.006)
    with pytest.raises(CovarianceError, match="between 0 and 1"):
        covariance.ellipsoid(1.0)


def test_json_gives_the_same_covariance_back():
    covariance = some_covariance()
    again = ObjectCovariance.from_json(json.loads(json.dumps(covariance.to_json())))
    assert isinstance(again, ObjectCovariance)
    np.testing.assert_array_equal(again.matrix, covariance.matrix)
    assert (again.axes, again.source, again.subject) == (covariance.axes, "marginals", "chair 3")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"matrix": [[1.0, 0.0], [0.0, 1.0]]}, "shape"),
        ({"matrix": "none"}, "numbers"),
        ({"matrix": [[10**400]]}, "numbers"),
        ({"axes": 3}, "text"),
        ({"axes": ["a"] * LENGTH}, "in this order"),
        ({"source": None}, "text"),
    ],
)
def test_a_broken_document_is_refused(change, message):
    with pytest.raises(CovarianceError, match=message):
        ObjectCovariance.from_json(some_covariance().to_json() | change)
    document = some_covariance().to_json()
    del document["axes"]
    with pytest.raises(CovarianceError, match="must have"):
        ObjectCovariance.from_json(document)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, -1.0]),
        np.array([[1.0, 0.5], [0.0, 1.0]]),
        np.array([[np.nan, 0.0], [0.0, 1.0]]),
        np.array([[0.0, 0.5], [0.5, 1.0]]),
        np.array([[0.0, 1e-9], [1e-9, 1.0]]),
    ],
)
def test_what_is_no_covariance_is_refused(matrix):
    with pytest.raises(CovarianceError, match="table 2: the covariance"):
        LabelledCovariance(matrix, ("a", "b"), "marginals", "table 2")


def test_asymmetry_is_measured_by_the_variances_of_its_axes():
    matrix = np.diag([1e6, 1e-4, 1e-4])
    matrix[1, 2] = 0.9e-4
    with pytest.raises(CovarianceError, match="not symmetric"):
        LabelledCovariance(matrix, ("a", "b", "c"), "marginals")


@given(st.integers(0, 1000))
def test_what_was_saved_in_single_precision_is_read(seed):
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-4, 3, LENGTH)
    matrix = some_covariance(seed).matrix * np.outer(sizes, sizes)
    matrix[seed % LENGTH] = matrix[:, seed % LENGTH] = 0.0
    ObjectCovariance.of(matrix.astype(np.float32), "marginals")


def test_a_table_is_titled_with_any_subject():
    console = Console(width=120, record=True)
    with console.capture() as capture:
        console.print(LabelledCovariance(np.eye(1), ("a",), "adam", "chair [/2] [red]").table())
    assert "chair [/2] [red] (adam)" in capture.get()


def test_the_table_names_every_axis_and_what_it_goes_along_with():
    matrix = np.diag(np.square(np.linspace(0.1, 0.9, 9)))
    matrix[3, 8] = matrix[8, 3] = -0.8 * 0.4 * 0.9
    console = Console(width=120, record=True)
    with console.capture() as capture:
        console.print(ObjectCovariance.of(matrix, "marginals", "chair 3").table())
    text = capture.get()
    assert all(axis in text for axis in RIGID_AXES)
    assert "-0.80 log_scale_z" in text
    assert "-0.80 translation_x" in text


def test_in_the_table_what_does_not_vary_goes_along_with_nothing():
    """... of an object whose size is held exactly."""
    matrix = np.diag([1e-4] * 6 + [0.0] * 3)
    console = Console(width=120, record=True)
    with console.capture() as capture:
        console.print(ObjectCovariance.of(matrix, "marginals").table())
    assert "-1.00" not in capture.get()


def test_fusing_an_estimate_with_itself_changes_nothing():
    state, covariance = some_state(), some_covariance()
    found, matrix = fused((state, covariance), (state, covariance), 0.3)
    np.testing.assert_allclose(matrix.matrix, covariance.matrix, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.T_world_object.matrix(), state.T_world_object.matrix(), atol=1e-12)
    assert matrix.source == "fused"


def test_fusion_is_consistent_whatever_the_errors_have_in_common():
    """No direction in which the result claims less than the true variance of the fused error, for any correlation."""
    rng = np.random.default_rng(1)
    a, b = some_covariance(3).matrix[:9, :9], some_covariance(4).matrix[:9, :9]
    state = ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(0))
    _, claimed = fused((state, ObjectCovariance.of(a, "x")), (state, ObjectCovariance.of(b, "y")))
    gain = claimed.matrix @ (0.5 * np.linalg.inv(b))
    rest = np.eye(9) - gain
    for _ in range(50):
        q, _ = np.linalg.qr(rng.normal(size=(9, 9)))
        cross = np.linalg.cholesky(a) @ (rng.uniform(-1, 1) * q) @ np.linalg.cholesky(b).T
        true = rest @ a @ rest.T + gain @ b @ gain.T + rest @ cross @ gain.T + gain @ cross.T @ rest.T
        assert np.linalg.eigvalsh(claimed.matrix - true).min() > -1e-9


def test_fused_estimates_lie_between_and_of_two_decoders_there_is_none():
    a = ObjectState(gtsam.Pose3(), np.zeros(3), np.zeros(4))
    b = a.retract(np.full(LENGTH, 0.02))
    covariance = ObjectCovariance.diagonal(np.full(LENGTH, 1e-2), "x")
    state, _ = fused((a, covariance), (b, covariance), 0.25)
    np.testing.assert_allclose(state.code, 0.015)
    np.testing.assert_allclose(state.log_scale, 0.015)
    with pytest.raises(CovarianceError, match="different decoders"):
        fused((a, covariance), (b, ObjectCovariance.diagonal(np.ones(9), "y")))
    with pytest.raises(CovarianceError, match="share"):
        fused((a, covariance), (b, covariance), 1.5)


@pytest.mark.parametrize(
    ("state", "size", "message"),
    [
        (replace(some_state(), log_scale=np.array([0.0, 0.0, 2000.0])), LENGTH, "not finite"),
        (some_state(), LENGTH - 1, f"over {LENGTH - 1} axes"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_a_covariance_of_something_else_is_refused(state, size, message):
    with pytest.raises(CovarianceError, match=message):
        of_xi(some_covariance(size=size), state)
