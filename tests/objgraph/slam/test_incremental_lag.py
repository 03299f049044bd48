"""What waits to enter a map, and what is in it, once cameras that saw it are past the lag."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.errors import InitialisationError
from objgraph.estimate.task import Estimate
from objgraph.observation.sampling import observe
from objgraph.slam.incremental.alone import Alone
from objgraph.slam.incremental.entrance import VIEWS_ENOUGH
from objgraph.slam.incremental.front_end import FrontEnd
from objgraph.slam.incremental.pending import PendingObject
from objgraph.trust import Trust
from objgraph.trust.judge import judge
from tests.objgraph.slam.undecoded import enter, see, undecoded
from tests.objgraph.trust.calibrations import calibration
from tests.toys import toy_frame, toy_prior, toy_state

LAG = 4


@pytest.fixture
def objects(monkeypatch) -> FrontEnd:
    system = undecoded(monkeypatch, LAG)
    return FrontEnd(system, lambda _: toy_prior(), lambda _: pytest.fail("none enters"))


@pytest.fixture
def pending() -> PendingObject:
    """Seen once."""
    view = observe(toy_frame([toy_state()], 0.3), 1)
    estimate = Estimate(toy_state(), None, 1, 1, 1, 1)
    return PendingObject(0, "chair 0", toy_prior(), estimate, 0, [(X(0), view)], {X(0): gtsam.Pose3()})


def test_an_object_in_doubt_waits_no_longer_for_views_that_go_past_the_lag(objects, pending, monkeypatch):
    monkeypatch.setattr(Alone, "first", lambda _: pending.estimate)
    monkeypatch.setattr(Alone, "trust", lambda *_: Trust(0.2, 0.2))
    seen, said = 1, []
    while seen < 20:
        from_there = gtsam.Pose3(gtsam.Rot3(), np.array([seen, -3.0, 1.0]))
        pending.see(X(seen), from_there, pending.views[-1][1], seen)
        pending.follow({key: pending.cameras[key] for key, _ in pending.views[-LAG:]})
        seen += 1
        if pending.is_ripe(objects.config):
            said.append(objects.entrance._doubt(pending))
            if said[-1] is None:
                break
    assert seen == VIEWS_ENOUGH
    assert len(pending.views) == LAG
    assert said == [f"chair 0 waits for {n} views: its pose is right with 20 %" for n in (5, 9)] + [None]


def test_an_object_whose_cameras_are_past_the_lag_is_given_up_for_that(objects, pending):
    objects.entrance.waiting.append(pending)
    _, reasons = objects.entrance.admit()
    assert reasons == ["chair 0 is given up: the cameras that saw it are past the lag"]
    assert objects.pending == ()


def test_an_object_without_views_is_not_judged(objects):
    for k in range(2):
        see(objects.system, k, [])
    entry = enter(objects.system, 0, [X(0), X(1)])
    for k in range(2, 2 + 2 * LAG):
        see(objects.system, k, [])
    assert objects.views(entry) == []
    with pytest.raises(InitialisationError, match="chair 0 has no views to be judged by"):
        judge(objects, entry, calibration("toy"))
