"""Objects that were started twice are merged, and only those."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import FactorError
from objgraph.slam.association import AssociationConfig, duplicates
from tests.objgraph.slam.association_cases import mapped, row, shifted
from tests.toys import toy_state


@settings(max_examples=8)
@given(st.permutations(range(5)))
def test_duplicates_do_not_depend_on_order(order):
    state = toy_state()
    objects = [
        mapped(shifted(state, 0.03 * i, 0.0, 0.0), f"chair {i}", sigma=0.05 - 0.01 * i) for i in range(3)
    ]
    objects += [mapped(shifted(state, 0.8, 0.0, 0.0)), mapped(state, category="table")]
    merges = duplicates([objects[i] for i in order])
    assert {(order[merge.keep], order[merge.drop]) for merge in merges} == {(2, 0), (2, 1)}


def test_a_chair_started_twice_is_merged_into_the_better_determined(caplog):
    state = toy_state()
    turned = replace(
        shifted(state, 0.06, -0.04, 0.0),
        T_world_object=shifted(state, 0.06, -0.04, 0.0).T_world_object.retract(np.r_[0, 0.1, 0, 0, 0, 0]),
        code=state.code + 0.3,
    )
    objects = [mapped(turned, "late", sigma=0.05), mapped(state, "early", sigma=0.02)]
    with caplog.at_level(logging.INFO, "objgraph"):
        (merge,) = duplicates(objects)
    assert (merge.keep, merge.drop) == (1, 0)
    assert merge.overlap > 0.8
    assert caplog.messages == [merge.reason]
    assert merge.reason.startswith("late is early, which is better determined")


def test_near_but_distinct_chairs_are_not_merged():
    a, b = row(2, 0.58)  # as wide as the chairs are: they touch
    assert duplicates([mapped(a, sigma=0.3), mapped(b, sigma=0.3)]) == ()
    assert duplicates([mapped(a, sigma=0.3), mapped(shifted(a, 0.1, 0.0, 0.0), sigma=0.3)]) != ()


def test_a_joint_covariance_tightens_the_gate_of_duplicates():
    """Both owe their uncertainty to one camera, so that their difference is known well."""
    state = toy_state()
    objects = [mapped(state, sigma=0.2), mapped(shifted(state, 0.2, 0.0, 0.0), sigma=0.2)]
    assert len(duplicates(objects)) == 1
    block = 0.2**2 * np.eye(6)
    config = AssociationConfig(unmodelled=0.005)
    shared = np.block([[block, 0.999 * block], [0.999 * block, block]])
    assert duplicates(objects, config, joint=lambda a, b: shared) == ()
    with pytest.raises(FactorError, match="12x12"):
        duplicates(objects, joint=lambda a, b: np.eye(6))


def test_one_surface_in_one_place_is_one_object_however_sure_both_are():
    """A wrong solution's covariance knows nothing of the right one's place."""
    state = toy_state()
    objects = [mapped(state, sigma=0.001), mapped(shifted(state, 0.08, 0.0, 0.0), sigma=0.001)]
    config = AssociationConfig(unmodelled=0.001)
    (merge,) = duplicates(objects, config)
    assert merge.mahalanobis > 40
    assert duplicates([objects[0], mapped(shifted(state, 0.25, 0.0, 0.0), sigma=0.001)], config) == ()


@settings(max_examples=20)
@given(st.floats(0.001, 0.2), st.sampled_from([None, 0, 1, 2]), st.booleans(), st.floats(-0.05, 0.05))
def test_centres_that_are_held_differ_by_as_much_as_what_is_not_held_allows(sigma, free, same, apart):
    """By a hard constraint, or as the difference of two poses that owe all of their errors to one camera."""
    state = toy_state()
    shift = np.zeros(3) if free is None else apart * np.eye(3)[free]
    variances = np.zeros(6) if free is None else np.repeat([0.0, sigma**2], 3) * np.tile(np.eye(3)[free], 2)
    R = np.kron(np.eye(2), state.T_world_object.rotation().matrix().T)  # along the world's axes
    block = R @ np.diag(variances) @ R.T
    joint = (
        np.kron(np.eye(2), block)
        if same
        else np.kron([[1, 1], [1, 1]], 0.3 * np.eye(6)) + np.kron(np.eye(2), block)
    )
    two = [mapped(state, "a"), mapped(shifted(state, *shift), "b")]
    (merge,) = duplicates(two, AssociationConfig(unmodelled=0.0), joint=lambda a, b: joint)
    expected = 0.0 if free is None else abs(apart) / (np.sqrt(2) * sigma)
    assert merge.mahalanobis == pytest.approx(expected, rel=1e-6, abs=1e-6)
    off = [two[0], mapped(shifted(state, *(shift + 0.01 * np.roll(np.eye(3)[free or 0], 1))), "b")]
    (merge,) = duplicates(off, AssociationConfig(unmodelled=0.0), joint=lambda a, b: joint)
    assert merge.mahalanobis == np.inf
