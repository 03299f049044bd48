"""Cameras that are known to some accuracy only, of one object in a graph of its own."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from hypothesis import given, settings
from hypothesis import strategies as st

from objgraph.errors import ConfigError
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.single_object import SingleObject
from objgraph.graph.solve import solve
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from tests.toys import toy_frame, toy_prior, toy_state

SAMPLING = SamplingConfig(points=80, hits=40, free=40)
STATE = toy_state()
UP = np.array([0.0, 0.0, 1.0])


def views(*azimuths: float) -> list[ObjectView]:
    return [observe(toy_frame([STATE], a, seed=i), 1, SAMPLING) for i, a in enumerate(azimuths)]


def alone(
    seen: list[ObjectView], pose_sigma: tuple[float, float] | None, up: np.ndarray | None = None
) -> SingleObject:
    problem = ObjectBuilder(GraphConfig(pose_sigma=pose_sigma), up_world=up).alone(toy_prior(), STATE, seen)
    problem.refresh(400.0)
    return problem


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-3, 0.05), st.floats(1e-3, 0.1))
def test_one_view_adds_the_camera_s_covariance_to_the_object_s(rotation: float, translation: float):
    """All that is said of the object's place is said in the camera's frame: the camera's error carries it along rigidly."""
    (view,) = views(0.3)
    exact = alone([view], None).marginals().matrix
    unsure = alone([view], (rotation, translation)).marginals().matrix
    T_object_camera = STATE.T_world_object.inverse().compose(view.T_world_camera)
    carried = T_object_camera.AdjointMap()
    camera = np.diag(np.repeat([rotation, translation], 3) ** 2)
    expected = np.array(exact)
    expected[:6, :6] += carried @ camera @ carried.T
    deviations = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        unsure / np.outer(deviations, deviations), expected / np.outer(deviations, deviations), atol=1e-4
    )


def test_exact_poses_are_the_limit():
    seen = views(0.3, 2.0)
    exact, nearly = alone(seen, None, UP), alone(seen, (1e-7, 1e-7), UP)
    np.testing.assert_allclose(nearly.marginals().matrix, exact.marginals().matrix, rtol=1e-4, atol=1e-9)
    for problem in (exact, nearly):
        solve([problem])
    difference = exact.state.local_coordinates(nearly.state)
    deviations = np.sqrt(np.diag(exact.marginals().matrix))
    assert np.abs(difference / deviations).max() < 0.05


def test_views_whose_poses_are_off_are_brought_together():
    """Two cameras 3 cm off, each to another side: the estimate says so, and fits better for it."""
    seen = views(0.3, 2.0, 3.6)
    off = [gtsam.Pose3(gtsam.Rot3(), np.array([0.03 * sign, 0, 0])) for sign in (1.0, -1.0, 0.0)]
    moved = [view.at(view.T_world_camera.compose(by)) for view, by in zip(seen, off, strict=True)]
    exact, unsure = alone(moved, None, UP), alone(moved, (0.003, 0.03), UP)
    solve([exact, unsure])
    assert exact.failure is None
    assert unsure.failure is None
    assert unsure.cost < 0.8 * exact.cost
    apart = [
        view.T_world_camera.localCoordinates(unsure.values.atPose3(X(k)))[3:] for k, view in enumerate(moved)
    ]
    assert apart[0][0] < -0.005
    assert apart[1][0] > 0.005
    assert (
        unsure.marginals().block("translation").matrix.trace()
        > exact.marginals().block("translation").matrix.trace()
    )


@pytest.mark.parametrize("wrong", [(0.0, 0.01), (-1.0, 0.01), (np.nan, 0.01), (0.01,)])
def test_what_is_no_pair_of_deviations_is_refused(wrong: tuple):
    with pytest.raises(ConfigError, match="pose_sigma"):
        replace(GraphConfig(), pose_sigma=wrong)
