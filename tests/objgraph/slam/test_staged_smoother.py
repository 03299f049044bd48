"""What the caller's own smoother cannot take, or has lost, is named before anything is changed."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, O, S, X

from factors.state import ObjectKeys
from objgraph.errors import ConfigError, FactorError, SolveError
from objgraph.slam import ObjectFrontEnd
from objgraph.slam.incremental.front_end import FrontEnd
from objgraph.slam.incremental.staged import StagedSmoother
from tests.objgraph.slam.undecoded import enter, see, undecoded
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
TIGHT = gtsam.noiseModel.Isotropic.Sigma
HERE = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0]))


def owner() -> gtsam.ISAM2:
    """A camera, a vector where an object's scale might be, a point, and a camera of which no factor says anything."""
    graph, values, isam = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.ISAM2()
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), TIGHT(6, 0.1)))
    graph.push_back(gtsam.PriorFactorVector(S(0), np.zeros(3), TIGHT(3, 0.1)))
    graph.push_back(gtsam.PriorFactorPoint3(L(0), np.zeros(3), TIGHT(3, 0.1)))
    for key in (X(0), X(5)):
        values.insert(key, gtsam.Pose3())
    for key in (S(0), L(0)):
        values.insert(key, np.zeros(3))
    isam.update(graph, values)
    return isam


def test_a_key_that_is_taken_is_refused():
    smoother, values = StagedSmoother(owner()), gtsam.Values()
    values.insert(S(0), np.zeros(3))
    with pytest.raises(SolveError, match="s0: in your smoother already: give other object_keys"):
        smoother.update([gtsam.PriorFactorVector(S(0), np.zeros(3), TIGHT(3, 1.0))], values)
    changes = smoother.hand_over()
    assert changes.factors.size() == changes.values.size() == 0


def test_what_is_not_determined_is_named():
    smoother, values = StagedSmoother(owner()), gtsam.Values()
    with pytest.raises(SolveError, match="x5: the incremental system hardly determines them"):
        smoother.covariance([X(5)])
    values.insert(O(0), HERE)
    smoother.update([gtsam.RangeFactorPose3(X(0), O(0), 1.0, TIGHT(1, 0.1))], values)
    with pytest.raises(SolveError, match="o0: the incremental system hardly determines them"):
        smoother.covariance([O(0)])


def test_a_camera_that_is_no_pose_is_named():
    objects = ObjectFrontEnd(owner(), UP, find_prior=lambda _: toy_prior())
    with pytest.raises(SolveError, match="l0 holds no pose"):
        objects.step(toy_frame([toy_state()], 0.3), [], camera=L(0))


def fail(_: int) -> ObjectKeys:
    raise FactorError("no keys are left")


@pytest.mark.parametrize(
    ("object_keys", "error", "message"),
    [
        (lambda n: [][n], ConfigError, r"object_keys\(0\) failed: IndexError"),
        (lambda n: n, ConfigError, r"object_keys\(0\) must be of type ObjectKeys, not int"),
        (fail, FactorError, "no keys are left"),
    ],
)
def test_keys_that_are_none_are_a_typed_error(monkeypatch, object_keys, error, message):
    objects = FrontEnd(undecoded(monkeypatch), lambda _: toy_prior(), object_keys)
    with pytest.raises(error, match=message):
        objects.entrance.next_keys()


def test_an_object_that_the_smoother_has_lost_leaves(monkeypatch):
    system = undecoded(monkeypatch)
    for k in range(2):
        see(system, k, [])
    lost, left = (enter(system, i, [X(0), X(1)]) for i in range(2))
    objects = FrontEnd(system, lambda _: toy_prior(), ObjectKeys.numbered)
    objects.places.note(objects.objects)
    has = system.smoother.has
    monkeypatch.setattr(system.smoother, "has", lambda key: key != lost.keys.pose and has(key))
    said = objects.keep_current([lost, left], everything=True)
    assert said == ["chair 0 has left: its variables are not in your smoother any more"]
    assert objects.objects == [left]
    assert objects.keep_current([left], everything=True) == []
