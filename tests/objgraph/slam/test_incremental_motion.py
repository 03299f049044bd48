"""What a motion adds to what is known of cameras, against samples of it."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.slam.incremental.config import IncrementalConfig
from objgraph.slam.incremental.motion import anchored, joint_with_last_camera, known_already, moved
from objgraph.slam.odometry import OdometryNoise

NOISE = OdometryNoise(translation=0.02, rotation=2e-3)


def pose(rng: np.random.Generator) -> gtsam.Pose3:
    return gtsam.Pose3.Expmap(rng.uniform(-1, 1, 6))


def covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return 1e-6 * root @ root.T / size


@pytest.mark.parametrize("seed", [0, 1])
def test_covariances_are_those_of_samples(seed):
    rng = np.random.default_rng(seed)
    first, last, before, now = (pose(rng) for _ in range(4))
    motion = moved(X(3), X(4), last, before, now, NOISE)
    assert motion.T_previous_current is not None
    assert motion.covariance is not None
    joint = covariance(rng, 12)
    own, T_first_object = 1e-6 * np.eye(9), pose(rng)
    on_first = first.compose(T_first_object)
    carried = motion.with_camera(joint)
    hanging = motion.with_camera(joint_with_last_camera(own, on_first.between(first), joint))
    errors, of_object = [], []
    for e, n in zip(
        rng.multivariate_normal(np.zeros(12), joint, 4000),
        rng.multivariate_normal(np.zeros(6), motion.covariance, 4000),
        strict=True,
    ):
        a = first.compose(gtsam.Pose3.Expmap(e[:6]))
        new = last.compose(gtsam.Pose3.Expmap(e[6:])).compose(motion.T_previous_current)
        new = new.compose(gtsam.Pose3.Expmap(n))
        errors.append(np.r_[e[:6], gtsam.Pose3.Logmap(motion.predicted.between(new))])
        o = 1e-3 * rng.normal(size=9)
        body = on_first.between(a.compose(T_first_object).compose(gtsam.Pose3.Expmap(o[:6])))
        of_object.append(np.r_[gtsam.Pose3.Logmap(body), o[6:], errors[-1][6:]])
    for found, samples in ((carried, errors), (hanging, of_object)):
        scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
        assert np.abs((np.cov(np.array(samples).T) - found) / scale).max() < 0.1


def test_what_the_last_camera_saw_goes_along_with_it():
    rng = np.random.default_rng(2)
    own, last, T_object_last = covariance(rng, 9), covariance(rng, 6), pose(rng)
    twice = np.tile(last, (2, 2))
    np.testing.assert_array_equal(
        joint_with_last_camera(own, T_object_last, last), joint_with_last_camera(own, T_object_last, twice)
    )


def test_a_camera_that_comes_first_or_is_known_adds_nothing():
    rng = np.random.default_rng(3)
    here, joint = pose(rng), covariance(rng, 12)
    first, known = anchored(X(0), here, IncrementalConfig()), known_already(X(0), here)
    np.testing.assert_array_equal(first.with_camera(joint), joint)
    np.testing.assert_allclose(known.with_camera(joint), joint, atol=1e-18)
