"""Objects that the map has twice become one: whatever the lag has taken, and nothing of the caller's is lost."""

from types import SimpleNamespace
from typing import Any, cast

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from factors.state import ObjectKeys
from objgraph.errors import SolveError
from objgraph.slam.association import Merge
from objgraph.slam.incremental import entrance
from objgraph.slam.incremental import system as module
from objgraph.slam.incremental.front_end import FrontEnd
from objgraph.slam.incremental.pending import PendingObject
from objgraph.slam.incremental.staged import StagedSmoother
from objgraph.slam.incremental.system import IncrementalSystem
from objgraph.slam.incremental.tracked import TrackedObject
from objgraph.slam.incremental.upkeep import Upkeep
from tests.objgraph.slam.undecoded import NOISE, enter, see, undecoded
from tests.toys import toy_prior

LAG = 3.0


def doubles(system: IncrementalSystem, frames: int, count: int = 2) -> list[TrackedObject]:
    """Objects seen in the first three frames, the first of them in all."""
    see(system, 0, [])
    see(system, 1, [])
    entries = [enter(system, i, [X(0), X(1)]) for i in range(count)]
    for k in range(2, frames):
        see(system, k, entries if k == 2 else entries[:1])
    return entries


@pytest.mark.parametrize("frames", [4, 5, 6, 7])
def test_an_object_merges_whatever_of_it_is_past_the_lag(monkeypatch, frames):
    """None of its views, one, two, all: it leaves the map, and with the last of its cameras the smoother."""
    system = undecoded(monkeypatch, LAG)
    keep, drop = doubles(system, frames)
    held = [(camera, view) for camera, view in drop.placed_views if system.smoother.has(camera)]
    assert len(held) == 7 - frames
    system.adopt(keep, held, instead_of=drop)
    assert system.objects == [keep]
    assert keep.views == frames + 3
    for k in range(frames, frames + 6):
        see(system, k, [keep])
        left = {system.smoother.has(key) for key in drop.keys}
        assert len(left) == 1  # never without its priors
        for entry in (keep, drop) if left == {True} else (keep,):
            sigma = np.sqrt(np.diag(system.smoother.covariance([*entry.keys])))
            assert sigma.max() < 1 + 1e-6
    assert not any(system.smoother.has(key) for key in drop.keys)


@pytest.mark.parametrize("lag", [None, LAG])
def test_an_object_that_a_factor_of_the_caller_s_holds_neither_merges_nor_turns(monkeypatch, lag):
    system = undecoded(monkeypatch, lag)
    keep, drop = doubles(system, 3)
    see(system, 3, [], [gtsam.PriorFactorPose3(drop.keys.pose, gtsam.Pose3(), NOISE)])
    held = "chair 1 stays as it is: a factor of yours on o1 holds it"
    with pytest.raises(SolveError, match=held):
        system.adopt(keep, drop.placed_views, instead_of=drop)
    with pytest.raises(SolveError, match=held):
        Upkeep(system)._turn(drop, ObjectKeys.numbered(2), system.state(drop))
    assert system.objects == [keep, drop]
    assert system.smoother.has(drop.keys.pose)
    system.adopt(drop, keep.placed_views, instead_of=keep)
    assert system.objects == [drop]


def test_an_object_that_the_map_has_is_said_to_be_that_one_however_well_it_is_known(monkeypatch):
    system = undecoded(monkeypatch)
    (entry,) = doubles(system, 3, count=1)
    objects = FrontEnd(system, lambda _: toy_prior(), ObjectKeys.numbered)
    (placed, *_), estimate = entry.placed_views, cast(Any, SimpleNamespace(state=system.state(entry)))
    waiting = PendingObject(7, "chair 7", entry.prior, estimate, 0, [placed], {X(0): gtsam.Pose3()})
    monkeypatch.setattr(PendingObject, "candidate", lambda _: None)
    monkeypatch.setattr(objects.places, "of", lambda _: [entry])
    better = Merge(0, 1, "chair 0 is chair 7, which is better determined", 1.0, 0.75)
    monkeypatch.setattr(entrance, "duplicates", lambda *_: [better])
    said = "chair 7 is chair 0, which the map has already: d2 1.0 in 3 directions, surfaces 0.75"
    assert objects.entrance._enter(waiting) == [said]
    assert entry.views == 4


def test_a_map_that_cannot_be_settled_is_as_it_was(monkeypatch):
    system = undecoded(monkeypatch)
    entry, _ = doubles(system, 4)
    keys, observations = [*system.cameras, entry.keys.pose], entry.observations
    before = [system.smoother.pose(key) for key in keys]
    made, frozen = [(o.quadratic, o.point) for o in observations], []
    shift = gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.0, 0.0]))

    def shifted(observations, values):
        return [gtsam.BetweenFactorPose3(o.keys[0], o.keys[1], shift, NOISE) for o in observations]

    def fail():
        raise SolveError("it does not settle")

    monkeypatch.setattr(module, "linearize_frozen", shifted)
    monkeypatch.setattr(module, "freeze", lambda _, values, slope: frozen.append(values))
    monkeypatch.setattr(module, "at_optimum", lambda name, known, observations, values: values)
    monkeypatch.setattr(system.smoother, "settle", fail)
    with pytest.raises(SolveError, match="it does not settle"):
        system.solve_whole(1)
    assert all(o.quadratic is quadratic for o, (quadratic, _) in zip(observations, made, strict=True))
    assert all(point in frozen for _, point in made)
    assert all(system.smoother.holds(o.number) for o in observations)
    system.commit()
    for key, pose in zip(keys, before, strict=True):
        assert system.smoother.pose(key).equals(pose, 1e-6)


def test_a_merge_that_fails_costs_none_of_the_others(monkeypatch):
    system = undecoded(monkeypatch)
    entries, adopt = doubles(system, 4, count=3), system.adopt
    merges = [Merge(0, 1, "1 is 0", 0.0, 1.0), Merge(0, 2, "2 is 0", 0.0, 1.0)]
    monkeypatch.setattr(entrance, "duplicates", lambda *_: merges)

    def fail_once(keep, placed, instead_of):
        monkeypatch.setattr(system, "adopt", adopt)
        raise SolveError("they do not fit")

    monkeypatch.setattr(system, "adopt", fail_once)
    objects = FrontEnd(system, lambda _: toy_prior(), lambda _: entries[0].keys)
    objects.places.note(entries)
    assert objects.entrance.merge(entries) == [
        "chair 1 is not merged with chair 0: they do not fit",
        "2 is 0",
    ]
    assert system.objects == entries[:2]


def test_an_object_whose_camera_the_caller_has_taken_out_leaves_his_smoother_whole(monkeypatch):
    """With the camera's factors, those of the object among them: nothing of what it saw is left to hold the object."""
    system, isam = undecoded(monkeypatch), gtsam.ISAM2()
    staged = StagedSmoother(isam)
    monkeypatch.setattr(system, "smoother", staged)

    def hand_over() -> None:
        staged.accept(isam.update(*staged.hand_over()).getNewFactorsIndices())

    keep, drop = doubles(system, 3)
    level = gtsam.PoseRotationPrior3D(drop.keys.pose, gtsam.Rot3(), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    drop.numbers += system.commit([level])
    hand_over()
    graph = isam.getFactorsUnsafe()
    gone = [i for i in range(graph.size()) if X(2) in list(graph.at(i).keys())]
    isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), gone)
    assert not staged.has(X(2))
    system.adopt(keep, system.held(drop), instead_of=drop)
    hand_over()
    assert not any(isam.valueExists(key) for key in drop.keys)
    assert all(isam.valueExists(key) for key in keep.keys)
    assert keep.has_lost_views
    assert not system.keeps_lost_views(keep)
