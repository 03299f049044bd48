"""Whether an object that is to enter is one that its priors hold for possible."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.code_mixture import CodeMixture
from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.solve import Problem
from objgraph.slam.incremental.local import settled
from objgraph.slam.incremental.tracked import TrackedObject
from tests.toys import TOY_CODE, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
KINDS = CodeMixture(
    weight=np.array([0.999, 0.001]),
    mean=np.stack([np.zeros(TOY_CODE), np.full(TOY_CODE, 3.0)]),
    variance=np.stack([np.full(TOY_CODE, 1e-8), np.full(TOY_CODE, 1.0)]),
)
"""The second kind is so rare that its rarity alone is above the limit."""


def settle_at(code: np.ndarray) -> np.ndarray:
    """The code of a chair that is seen to have this one."""
    entry = TrackedObject("chair 0", ObjectKeys.numbered(0), replace(toy_prior(), kinds=KINDS))
    priors = ObjectBuilder(GraphConfig(), UP).priors(entry.prior, entry.keys)
    state, values, graph = toy_state(), gtsam.Values(), gtsam.NonlinearFactorGraph()
    replace(state, code=code).insert(values, entry.keys)
    tight = gtsam.noiseModel.Isotropic.Sigma
    for factor in (
        *priors,
        gtsam.PriorFactorPose3(entry.keys.pose, state.T_world_object, tight(6, 1e-3)),
        gtsam.PriorFactorVector(entry.keys.code, code, tight(TOY_CODE, 1e-6)),
    ):
        graph.push_back(factor)
    return settled(Problem("chair 0", graph, values, []), priors, [], entry).atVector(entry.keys.code)


def test_a_rare_kind_is_as_possible_as_any_other():
    assert 2 * KINDS.rarity[1] > 80
    drawn = 3.0 + np.array([0.5, -1.0, 0.0, 1.5])
    np.testing.assert_allclose(settle_at(drawn), drawn, atol=1e-4)


def test_what_is_of_no_kind_is_refused():
    with pytest.raises(SolveError, match="its priors' chi-squared is"):
        settle_at(np.full(TOY_CODE, 9.0))
