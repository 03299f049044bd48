"""A shape fills its box: what is scored, its derivative, and what the factor is not of."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.base import Annealing
from factors.batch import prefetch
from factors.errors import FactorError
from factors.filled_box import FilledBoxFactor
from factors.state import RIGID_DOF, ObjectKeys, ObjectState
from tests.factors.conftest import CODE_LENGTH, SphereDecoder, assert_gtsam_has, make_decoder, random_state

KEYS = ObjectKeys.numbered(0)
SIGMA = 0.01


def values_of(code: np.ndarray, delta: np.ndarray | None = None, seed: int = 0) -> gtsam.Values:
    """An object of this code at some pose and scale, moved by a tangent."""
    state = random_state(np.random.default_rng(seed))
    state = ObjectState(state.T_world_object, state.log_scale, np.asarray(code, float))
    values = gtsam.Values()
    (state if delta is None else state.retract(delta)).insert(values, KEYS)
    return values


def cauchy(r: float) -> float:
    return 4.5 * np.log1p(r**2 / 9)


def test_its_camera_goes_along_with_the_object():
    """So that a map need not linearise it anew where the object was moved as a whole."""
    factor = FilledBoxFactor(KEYS, SphereDecoder(), np.ones(3), SIGMA)
    for delta in (np.zeros(14), np.r_[0.3, 0.1, -0.2, 5.0, 1.0, 2.0, np.zeros(8)]):
        values = values_of(np.zeros(CODE_LENGTH), delta)
        assert factor.T_world_camera(values).equals(factor.state(values).T_world_object, 0.0)


@given(st.floats(-0.1, 0.1), st.integers(0, 100))
@settings(max_examples=20)
def test_each_side_scores_how_far_the_surface_is_from_it(short, seed):
    """A sphere of radius .4 + code[0] in boxes of unequal edges: the least distance is known in closed form."""
    factor = FilledBoxFactor(KEYS, SphereDecoder(), np.array([0.8, 0.9, 0.7]), SIGMA)
    values = values_of(np.array([-short, 0, 0, 0, 0]), seed=seed)
    gaps = np.array([0.4, 0.45, 0.35]) - (0.4 - short)
    expected = 2 * sum(cauchy(gap / SIGMA) for gap in gaps)
    # the nearest place looked at is half a step from the middle of each side
    assert factor.loss(values) == pytest.approx(expected, rel=0.15, abs=0.15)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("edge", [0.7, 0.9, 1.6])
def test_the_gradient_is_the_losses_and_the_curvature_majorises(seed, edge):
    rng = np.random.default_rng(seed)
    factor = FilledBoxFactor(KEYS, make_decoder(), edge * np.ones(3), SIGMA)
    code = 0.3 * rng.normal(size=CODE_LENGTH)
    values = values_of(code)
    factor.refresh(values)
    rows = factor.rows(values)
    gradient = (rows.residual @ rows.jacobian).numpy()
    numerical, step = np.zeros(len(gradient)), 1e-7
    for i, e in enumerate(np.eye(len(numerical))):
        up, down = (factor.loss(values_of(code, sign * step * e)) for sign in (1, -1))
        numerical[i] = up - down
    np.testing.assert_allclose(
        gradient, numerical / (2 * step), rtol=1e-4, atol=1e-4 * np.abs(gradient).max()
    )
    assert 2 * rows.loss >= float(rows.residual @ rows.residual) - 1e-9
    assert_gtsam_has(factor, values, gradient)


def test_it_says_nothing_of_pose_and_scale():
    factor = FilledBoxFactor(KEYS, make_decoder(), 0.9 * np.ones(3), SIGMA)
    rows = factor.rows(values_of(np.ones(CODE_LENGTH)))
    assert (rows.jacobian[:, :RIGID_DOF] == 0).all()
    assert float(rows.jacobian.norm()) > 1
    assert factor.loss(values_of(np.ones(CODE_LENGTH), seed=3)) == rows.loss


def test_the_nearest_place_is_found_anew_as_the_code_changes():
    """Between refreshes too, among the places that were kept: the frozen loss is never above the start's own point's."""
    factor = FilledBoxFactor(KEYS, make_decoder(), 0.8 * np.ones(3), SIGMA)
    start = np.zeros(CODE_LENGTH)
    factor.refresh(values_of(start), Annealing(60.0))
    first = factor.active(factor.query(values_of(start)), factor._value(factor.query(values_of(start))))
    moved = values_of(0.8 * np.ones(CODE_LENGTH))
    query = factor.query(moved)
    value = factor._value(query)
    least = value[factor.active(query, value)]
    assert (least <= value[first]).all()
    assert (least < value[first]).any()


def test_decoding_ahead_changes_nothing():
    factor = FilledBoxFactor(KEYS, make_decoder(), 0.8 * np.ones(3), SIGMA)
    values = values_of(0.2 * np.ones(CODE_LENGTH))
    factor.refresh(values)
    alone = factor.rows(values)
    other = FilledBoxFactor(KEYS, factor.decoder, 0.8 * np.ones(3), SIGMA)
    other.refresh(values)
    prefetch([other], values, jacobian=True)
    ahead = other.rows(values)
    np.testing.assert_allclose(ahead.jacobian.numpy(), alone.jacobian.numpy(), rtol=1e-12)
    assert ahead.loss == pytest.approx(alone.loss)


def test_what_no_code_can_do_is_let_go():
    pulls = []
    for short in (0.01, 0.04, 0.35):
        factor = FilledBoxFactor(KEYS, SphereDecoder(), 0.8 * np.ones(3), SIGMA)
        rows = factor.rows(values_of(np.array([-short, 0, 0, 0, 0])))
        pulls.append(abs(float((rows.residual @ rows.jacobian)[RIGID_DOF])))
    assert pulls[1] > pulls[0]
    assert pulls[2] < 0.3 * pulls[1]


@pytest.mark.parametrize(
    ("box", "sigma"), [((1.0, 0.0, 1.0), 0.1), ((1.0, 1.0), 0.1), ((1.0, 1.0, 1.0), 0.0), ((np.nan, 1, 1), 1)]
)
def test_a_box_that_is_none_is_refused(box, sigma):
    with pytest.raises(FactorError, match="box"):
        FilledBoxFactor(KEYS, make_decoder(), np.array(box), sigma)


def test_a_code_of_another_length_is_refused():
    factor = FilledBoxFactor(KEYS, make_decoder(), np.ones(3), SIGMA)
    with pytest.raises(FactorError, match="length 3"):
        factor.loss(values_of(np.zeros(3)))


def test_frozen_again_at_the_same_code_it_asks_for_nothing(monkeypatch):
    """Pose, scale and slope say nothing to it."""
    factor = FilledBoxFactor(KEYS, make_decoder(), 0.8 * np.ones(3), SIGMA)
    factor.refresh(values_of(np.zeros(CODE_LENGTH)), Annealing(60.0))
    monkeypatch.setattr(factor, "_query", lambda *_: pytest.fail("decoded again"))
    factor.refresh(values_of(np.zeros(CODE_LENGTH), seed=1), Annealing(400.0))
    with pytest.raises(pytest.fail.Exception, match="decoded again"):
        factor.refresh(values_of(0.1 * np.ones(CODE_LENGTH)), Annealing(400.0))
