"""Estimates by gradients: an object that cannot be estimated fails alone and by name."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from objgraph.errors import SolveError
from objgraph.estimate import AdamEstimator, GaussNewtonEstimator
from objgraph.estimate.task import Estimate, EstimationTask
from tests.objgraph.estimate.adam_cases import GAUSS_NEWTON, SMALL, quick, result, task, views
from tests.toys import ToyDecoder, toy_state


class FragileDecoder(ToyDecoder):
    """Answers NaN to codes that ask for it, or to all once `broken` is set."""

    broken = False

    def _network(self, points, injected):
        lost = torch.full_like(points[:, 0], float(self.broken)) + (injected["0"][:, 0] > 50)
        return super()._network(points, injected) * torch.where(lost > 0, torch.nan, 1.0)


def lost_code(decoder: FragileDecoder) -> EstimationTask:
    """The others' decoder fails on this object alone."""
    start = toy_state(1.0, (99.0, 0, 0, 0))
    return task(1.0, decoder, starts=(start,), views=views(), name="lost")


def broken_decoder(_: FragileDecoder) -> EstimationTask:
    decoder = FragileDecoder().double()
    decoder.broken = True
    return task(0.4, decoder, name="lost")


def nan_start(decoder: FragileDecoder) -> EstimationTask:
    state = toy_state()
    return task(0.4, decoder, starts=(replace(state, log_scale=np.full(3, np.nan)),), name="lost")


@pytest.mark.parametrize("estimator", [AdamEstimator(SMALL), GAUSS_NEWTON])
@pytest.mark.parametrize("bad", [lost_code, broken_decoder, nan_start])
def test_a_failing_object_fails_alone_and_by_name(estimator, bad):
    decoder = FragileDecoder().double()
    before, failed, after = estimator.estimate([task(0.4, decoder), bad(decoder), task(2.0, decoder)])
    assert isinstance(failed, SolveError)
    assert "lost" in str(failed)
    for found, heading in ((before, 0.4), (after, 2.0)):
        assert isinstance(found, Estimate)
        alone = result(task(heading, decoder), estimator)
        np.testing.assert_allclose(found.state.matrix, alone.state.matrix, atol=1e-9)
        assert np.isfinite(found.cost_final)


@pytest.mark.parametrize("estimator", [AdamEstimator(SMALL), GAUSS_NEWTON, quick("graph")])
@pytest.mark.parametrize(
    "lacking", [{"starts": ()}, {"views": ()}, {"starts": (replace(toy_state(), code=np.zeros(1)),)}]
)
def test_a_task_that_cannot_be_used_fails_alone(estimator, lacking):
    good, bad = task(), replace(task(), name="lacking", **lacking)
    failed, found = estimator.estimate([bad, good])
    assert isinstance(failed, SolveError)
    assert "lacking" in str(failed)
    assert isinstance(found, Estimate)


class DeafDecoder(ToyDecoder):
    """Its shape does not depend on its code."""

    def _network(self, points, injected):
        return super()._network(points, {"0": 0 * injected["0"]})


def test_a_singular_system_is_named():
    deaf = task(0.4, DeafDecoder().double(), name="deaf chair")
    (found,) = GaussNewtonEstimator(replace(GAUSS_NEWTON.config, code_weight=0.0)).estimate([deaf])
    assert isinstance(found, SolveError)
    assert "deaf chair" in str(found)
    assert isinstance(GAUSS_NEWTON.estimate([deaf])[0], Estimate)
