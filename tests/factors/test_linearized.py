"""The quadratic of several factors: their gradient and curvature, and the same wherever the world is."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.base import Annealing
from factors.errors import FactorError
from factors.linearized import carried_along, linearized
from factors.state import ObjectKeys
from factors.surface import SurfaceFactor
from tests.factors.conftest import make_decoder, random_camera, random_state
from tests.factors.test_observation_factors import KEYS, make_factor, moved

SIX = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array)


def two_factors(seed: int = 4, fixed: bool = False):
    rng = np.random.default_rng(seed)
    decoder, values = make_decoder(), gtsam.Values()
    random_state(rng).insert(values, KEYS)
    values.insert(X(3), random_camera(rng))
    camera = values.atPose3(X(3)) if fixed else X(3)
    factors = [make_factor(kind, camera, rng, decoder) for kind in ("surface", "depth-full")]
    for factor in factors:
        factor.refresh(values, Annealing(slope=60.0))
    return factors, values


@pytest.mark.parametrize("fixed", [False, True])
def test_gradient_and_curvature_are_the_factors_own(fixed):
    factors, values = two_factors(fixed=fixed)
    together = gtsam.NonlinearFactorGraph()
    for factor in factors:
        together.push_back(factor.gtsam_factor())
    alone = gtsam.NonlinearFactorGraph()
    alone.push_back(linearized(factors, values))
    ordering = gtsam.Ordering(factors[0].keys)
    hessian, gradient = together.linearize(values).hessian(ordering)
    own_hessian, own_gradient = alone.linearize(values).hessian(ordering)
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(own_hessian, hessian, atol=1e-9 * scale)
    np.testing.assert_allclose(own_gradient, gradient, atol=1e-9 * np.abs(gradient).max())
    assert alone.error(values) == pytest.approx(together.error(values), rel=1e-9)


@given(SIX, st.integers(0, 3))
@settings(max_examples=25)
def test_moving_camera_and_object_together_changes_nothing(motion, seed):
    factors, values = two_factors(seed)
    quadratic = linearized(factors, values)
    shift = gtsam.Pose3.Expmap(motion)
    elsewhere = gtsam.Values(values)
    for key in (KEYS.pose, X(3)):
        elsewhere.update(key, shift.compose(values.atPose3(key)))
    assert quadratic.error(elsewhere) == pytest.approx(quadratic.error(values), rel=1e-6)
    ordering = gtsam.Ordering(factors[0].keys)
    here, there = (_linear(quadratic, at).hessian(ordering) for at in (values, elsewhere))
    for a, b in zip(here, there, strict=True):
        np.testing.assert_allclose(b, a, atol=1e-6 * np.abs(a).max())


@given(SIX, st.integers(0, 3))
@settings(max_examples=25)
def test_carried_along_it_is_the_same_function_there(motion, seed):
    factors, values = two_factors(seed)
    quadratic = linearized(factors, values)
    keys, dims = factors[0].keys, factors[0].dims
    shift = gtsam.Pose3.Expmap(motion)
    elsewhere = gtsam.Values(values)
    for key in (KEYS.pose, X(3)):
        elsewhere.update(key, shift.compose(values.atPose3(key)))
    step = 0.1 * np.random.default_rng(seed).normal(size=sum(dims))
    carried, point = carried_along(quadratic, values, elsewhere, KEYS.pose, X(3))
    assert point.equals(elsewhere, 1e-9)
    here, there = (moved(at, keys, dims, step) for at in (values, elsewhere))
    assert carried.error(there) == pytest.approx(quadratic.error(here), rel=1e-9)


def _linear(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor)
    return graph.linearize(values)


def test_a_relative_motion_is_felt():
    factors, values = two_factors()
    quadratic = linearized(factors, values)
    elsewhere = gtsam.Values(values)
    elsewhere.update(X(3), values.atPose3(X(3)).retract(np.full(6, 0.05)))
    assert quadratic.error(elsewhere) != pytest.approx(quadratic.error(values), rel=1e-3)


def test_only_factors_on_the_same_variables_have_a_common_quadratic():
    factors, values = two_factors()
    decoder, rng = make_decoder(), np.random.default_rng(0)
    other = SurfaceFactor(
        ObjectKeys.numbered(1), decoder, X(3), rng.normal(size=(5, 3)) + [0, 0, 2.0], np.full(5, 0.02)
    )
    for wrong in ([], [*factors, other]):
        with pytest.raises(FactorError, match="same variables"):
            linearized(wrong, values)
