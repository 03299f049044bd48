"""Factors and variables of the caller's own in an incremental map."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.observation.frames import Frame
from objgraph.slam import IncrementalConfig, IncrementalObjectGraph
from objgraph.slam.incremental.front_end import FrontEnd
from tests.objgraph.slam.undecoded import enter, see, undecoded
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
FRAME = toy_frame([toy_state()], 0.3)
LANDMARK = np.array([1.0, 0.0, 0.0])
NOISE = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)


def frame(k: int) -> Frame:
    T = FRAME.T_world_camera.copy()
    T[0, 3] += 0.1 * k
    return replace(FRAME, name=str(k), T_world_camera=T)


def sight(k: int) -> gtsam.NonlinearFactor:
    """Of the landmark, in the k-th frame."""
    seen = gtsam.Pose3(frame(k).T_world_camera).transformTo(LANDMARK)
    return gtsam.BearingRangeFactor3D(X(k), L(0), gtsam.Unit3(seen), float(np.linalg.norm(seen)), NOISE)


def landmark() -> gtsam.Values:
    values = gtsam.Values()
    values.insert(L(0), LANDMARK)
    return values


def test_a_landmark_lives_as_long_as_it_is_seen_and_cameras_do_not():
    objects, held = IncrementalObjectGraph(UP, config=IncrementalConfig(lag=3.0)), []
    for k in range(12):
        factors = [sight(k)] if k < 7 else []
        objects.update(frame(k), [], factors=factors, values=landmark() if k == 0 else None)
        held.append(objects.system.smoother.has(L(0)))
    assert held == [k < 10 for k in range(12)]
    assert not objects.system.smoother.has(X(7))


def test_a_map_whose_object_a_factor_of_the_caller_s_holds_has_a_batch_graph(monkeypatch):
    system = undecoded(monkeypatch)
    for k in range(2):
        see(system, k, [])
    entry = enter(system, 0, [X(0), X(1)])
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    see(system, 2, [], [gtsam.BetweenFactorPose3(X(2), entry.keys.pose, gtsam.Pose3(), noise)])
    entry.observations.clear()  # which are none that a graph takes
    monkeypatch.setattr(system, "state", lambda _: toy_state())
    batch = system.batch()
    (held,) = (
        i for i in range(batch.graph.size()) if list(batch.graph.at(i).keys()) == [X(2), entry.keys.pose]
    )
    assert held not in batch.objects[0].slots
    assert batch.state(batch.objects[0]).log_scale == pytest.approx(toy_state().log_scale)


def test_a_variable_of_which_no_factor_says_anything_is_refused():
    objects = IncrementalObjectGraph(UP)
    with pytest.raises(SolveError, match="l0: no factor of this update says anything of them"):
        objects.update(frame(0), [], values=landmark())
    assert not objects.cameras
    objects.update(frame(0), [], factors=[sight(0)], values=landmark())
    with pytest.raises(SolveError, match="l0 holds no pose"):
        objects.pose(L(0))


def test_the_next_camera_s_key_is_none_of_the_caller_s():
    objects, values = IncrementalObjectGraph(UP), gtsam.Values()
    values.insert(X(1), LANDMARK)
    objects.update(frame(0), [], factors=[gtsam.PriorFactorPoint3(X(1), LANDMARK, NOISE)], values=values)
    assert objects.next_camera == X(2)
    assert objects.update(frame(1), []).camera == X(2)


@pytest.mark.parametrize("rounds", [2.5, "a", -1])
def test_rounds_that_are_none_are_refused(rounds):
    with pytest.raises(SolveError, match="rounds must be"):
        IncrementalObjectGraph(UP).optimize(rounds)


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ([X(0), X(1), X(0)], "x0 is asked for twice"),
        (["x0"], r"chair 0: others\[0\] must be a key"),
        ([X(7)], "x7: not in the incremental system"),
    ],
)
def test_variables_that_have_no_covariance_with_an_object_are_named(monkeypatch, others, message):
    system = undecoded(monkeypatch)
    for k in range(2):
        see(system, k, [])
    entry = enter(system, 0, [X(0), X(1)])
    objects = FrontEnd(system, lambda _: toy_prior(), ObjectKeys.numbered)
    assert objects.joint_marginals(entry, [X(1)]).shape == (19, 19)
    with pytest.raises(SolveError, match=message):
        objects.joint_marginals(entry, others)


def test_a_camera_s_name_is_no_key():
    with pytest.raises(SolveError, match="camera must be a key"):
        IncrementalObjectGraph(UP).pose("x0")  # type: ignore[arg-type]
