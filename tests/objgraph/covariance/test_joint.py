"""Joint covariances where some directions are held exactly, against exact ones made nearly so."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.covariance.posterior import Posterior

FREE = np.array([0.1, 0.2, 0.3, 0.1, 0.2, 0.3])
PARTLY = np.array([0.0, 0.2, 0.0, 0.1, 0.0, 0.3])
START = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 0.9), np.array([0.5, -1.0, 0.2]))
MOTION = gtsam.Pose3(gtsam.Rot3.RzRyRx(-0.1, 0.4, 0.2), np.array([1.0, 0.3, -0.2]))


def chain(start: gtsam.NonlinearFactor) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Three cameras in a row, the first as `start` says."""
    graph, values, pose = gtsam.NonlinearFactorGraph(), gtsam.Values(), START
    graph.push_back(start)
    for k in range(3):
        values.insert(X(k), pose)
        pose = pose.compose(MOTION)
    for k in range(2):
        noise = gtsam.noiseModel.Diagonal.Sigmas(FREE)
        graph.push_back(gtsam.BetweenFactorPose3(X(k), X(k + 1), MOTION, noise))
    return graph, values


def prior(noise) -> gtsam.PriorFactorPose3:
    return gtsam.PriorFactorPose3(X(0), START, noise)


CONSTRAINED = gtsam.noiseModel.Constrained
CASES = {
    "equality": (gtsam.NonlinearEqualityPose3(X(0), START), np.zeros(6)),
    "constrained": (prior(CONSTRAINED.All(6)), np.zeros(6)),
    "partly": (prior(CONSTRAINED.MixedSigmas(1000.0, PARTLY)), PARTLY),
    "free": (prior(gtsam.noiseModel.Diagonal.Sigmas(FREE)), FREE),
}


@pytest.mark.parametrize("keys", [[X(0)], [X(2)], [X(0), X(1)], [X(2), X(0), X(1)]])
@pytest.mark.parametrize("case", CASES)
def test_what_is_held_exactly_has_no_covariance_and_the_rest_its_own(case, keys):
    start, sigmas = CASES[case]
    nearly = prior(gtsam.noiseModel.Diagonal.Sigmas(np.where(sigmas > 0, sigmas, 1e-6)))
    graph, values = chain(nearly)
    expected = (
        gtsam.Marginals(graph, values).jointMarginalCovariance(gtsam.KeyVector(sorted(keys))).fullMatrix()
    )
    order = np.concatenate([6 * sorted(keys).index(key) + np.arange(6) for key in keys])
    found = Posterior(*chain(start)).joint_covariance(keys)
    np.testing.assert_allclose(found, expected[np.ix_(order, order)], atol=1e-8)
