"""A map that grew frame by frame is, once optimised, the solution of all its factors at once."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from objgraph.errors import SolveError
from objgraph.slam.incremental.object_graph import IncrementalObjectGraph
from objgraph.slam.incremental.tracked import Observation
from tests.benchmarks.incremental_vs_batch import apart, batch, incremental
from tests.objgraph.slam.test_incremental import World, distance, mapped, two_chairs


@pytest.fixture(scope="module")
def world() -> World:
    return two_chairs(6)


def all_observations(objects: IncrementalObjectGraph) -> list[Observation]:
    return [observation for entry in objects.objects for observation in entry.observations]


def test_incremental_is_batch(world):
    """Means within a tenth of a standard deviation, and standard deviations within 5 %, of objects and cameras.

    Where every edge has a kink the optimum is not defined so well.
    """
    objects, _ = mapped(world, rounded=True)
    grown = incremental(objects)
    objects.optimize()
    numbers = [observation.number for observation in all_observations(objects)]
    assert len(set(numbers)) == len(numbers) >= 2 * 5
    assert all(objects.system.smoother.holds(number) for number in numbers)
    # from where the updates had left it, so that the optimum is found twice, and not by our optimiser
    whole = batch(objects, grown.values, by_gtsam=True)
    found = apart(incremental(objects), whole)
    assert found.mean < 0.1
    assert found.sigma_largest < 0.05
    assert apart(batch(objects, grown.values), whole).mean < 0.1
    assert apart(grown, whole).mean < 0.5


def test_a_batch_graph_stays_as_it_was_taken(world):
    objects, _ = mapped(replace(world, frames=world.frames[:4]))
    graph = objects.batch()
    cost, same = graph.graph.error(graph.values), objects.batch()
    assert same.graph.error(same.values) == cost
    for frame in world.frames[4:]:
        objects.update(frame, world.detections(frame))
    assert graph.graph.error(graph.values) == cost


def test_behind_a_lag_the_rest_is_optimised(world):
    objects, _ = mapped(replace(world, frames=world.frames[:5]), lag=2.5)
    assert not objects.system.smoother.has(X(0))
    kept = {o.camera for o in all_observations(objects) if objects.system.smoother.holds(o.number)}
    objects.optimize(rounds=1)
    assert {o.camera for o in all_observations(objects)} == kept
    assert all(objects.system.smoother.holds(o.number) for o in all_observations(objects))
    assert distance(objects.pose(X(4)), world.truth[4]) < 0.1
    report = objects.update(world.frames[5], world.detections(world.frames[5]))
    assert len(report.seen) == len(world.states)
    assert distance(objects.pose(X(5)), world.truth[5]) < 0.1


def test_what_cannot_be_optimised_stays_as_it_was(world, monkeypatch):
    objects, _ = mapped(replace(world, frames=world.frames[:3]))
    before = objects.estimate()
    bad = next(o for o in all_observations(objects) if o.view is not None)

    def fail(*_):
        raise SolveError("the decoder is gone")

    monkeypatch.setattr(bad.factors[0], "loss_of", fail)
    with pytest.raises(SolveError, match=r"the map: .*decoder is gone"):
        objects.optimize()
    after = objects.estimate()
    keys = gtsam.KeyVector(list(before.keys()))
    np.testing.assert_allclose(before.localCoordinates(after.extract(keys)).vector(keys), 0.0, atol=1e-12)
