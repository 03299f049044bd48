"""Objects in a graph that somebody else owns: his keys, his variables, and out again."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, O, X

from factors.state import ObjectKeys
from objgraph.errors import FactorError, ObservationError, PriorError, SolveError
from objgraph.graph.handle import Sighting
from objgraph.graph.object_graph import ObjectGraph
from objgraph.graph.solve import LevenbergMarquardtConfig, SolverConfig
from objgraph.observation.sampling import ObjectView
from tests.objgraph.graph.graph_cases import (
    NEAR,
    OFF,
    SHORT,
    UP,
    empty,
    moved,
    pose_error,
    pose_noise,
    views_of,
)
from tests.toys import toy_prior, toy_state


def test_own_keys_and_free_numbers():
    objects = empty()
    own = ObjectKeys(gtsam.symbol("p", 7), gtsam.symbol("q", 7), gtsam.symbol("r", 7))
    objects.values.insert(ObjectKeys.numbered(1).log_scale, np.zeros(2))  # somebody's s1
    first = objects.add_object(toy_prior(), toy_state(), keys=own)
    second = objects.add_object(toy_prior(), toy_state())
    third = objects.add_object(toy_prior(), toy_state())
    assert first.keys == own
    assert second.keys == ObjectKeys.numbered(2)
    assert third.keys == ObjectKeys.numbered(3)
    assert objects.values.size() == 1 + 3 * 3
    np.testing.assert_allclose(objects.values.atVector(own.code), toy_state().code)
    assert len({handle.name for handle in objects.objects}) == 3


def test_keys_of_factors_whose_values_are_yet_to_come_are_taken():
    objects = empty()
    objects.graph.push_back(gtsam.PriorFactorPose3(O(0), gtsam.Pose3(), pose_noise(1, 1)))
    assert objects.add_object(toy_prior(), toy_state()).keys == ObjectKeys.numbered(1)
    objects.values.insert(O(0), gtsam.Pose3())


def test_a_factor_on_nothing_is_of_no_part():
    """Marginalising everything out leaves such a one."""
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state)
    for view in views_of(state):
        objects.observe(handle, view)
    constant = gtsam.LinearContainerFactor(gtsam.JacobianFactor(np.ones(1)), gtsam.Values())
    objects.graph.push_back(constant)
    (problem,) = objects.optimize(SHORT)
    assert problem.name == handle.name
    assert objects.marginals(handle).matrix.shape == (13, 13)


def test_own_keys_are_solved_and_have_marginals():
    state, objects = toy_state(), empty()
    own = ObjectKeys(L(3), 17, gtsam.symbol("r", 0))
    handle = objects.add_object(toy_prior(), state.retract(0.3 * OFF), keys=own)
    for view in views_of(state):
        objects.observe(handle, view)
    objects.optimize(SHORT)
    assert pose_error(objects.state(handle).T_world_object, state.T_world_object)[1] < 0.02
    assert objects.marginals(handle).matrix.shape == (13, 13)


def test_taken_keys_are_an_error_that_changes_nothing():
    objects = empty()
    objects.values.insert(X(0), gtsam.Pose3())
    handle = objects.add_object(toy_prior(), toy_state())
    size = objects.graph.size()
    for taken in (handle.keys, ObjectKeys(O(9), gtsam.symbol("s", 9), X(0))):
        with pytest.raises(FactorError, match=r"o0|x0"):
            objects.add_object(toy_prior(), toy_state(), keys=taken)
    assert objects.values.size() == 4
    assert objects.graph.size() == size
    assert len(objects.objects) == 1


def test_a_code_of_another_length_is_an_error_that_names_it():
    objects = empty()
    with pytest.raises(FactorError, match=r"chair 0: a code of length 7, its decoder takes 4"):
        objects.add_object(toy_prior(), replace(toy_state(), code=np.zeros(7)))
    assert objects.values.size() == objects.graph.size() == 0


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"prior": 3}, PriorError, "prior .* must be of type ShapePrior, not int"),
        ({"start": "here"}, ObservationError, "chair 0: start .* must be a list or a tuple of ObjectView"),
        ({"keys": (1, 2, 3)}, FactorError, "chair 0: keys must be of type ObjectKeys"),
        ({"box": object()}, ObservationError, "box must be of type DetectedBox"),
    ],
)
def test_what_cannot_be_added_is_named_and_leaves_nothing(changes, error, message):
    objects = empty()
    with pytest.raises(error, match=message):
        objects.add_object(**({"prior": toy_prior(), "start": toy_state()} | changes))
    assert objects.values.size() == objects.graph.size() == len(objects.objects) == 0


def test_an_object_of_another_graph_is_named():
    objects, other = empty(), empty()
    handle = other.add_object(toy_prior(), toy_state())
    objects.add_object(toy_prior(), toy_state())
    for ask in (objects.state, objects.marginals, objects.stand_on_floor, objects.remove_object):
        with pytest.raises(FactorError, match="chair 0 is not in this graph"):
            ask(handle)


def test_a_variable_that_is_asked_for_twice_is_named():
    objects = empty(up_world=None)
    handle = objects.add_object(toy_prior(), toy_state())
    with pytest.raises(SolveError, match="o0 is asked for twice"):
        objects.joint_marginals(handle, [handle.keys.pose])


def test_a_camera_without_a_value_is_an_error_that_names_it():
    state, objects = toy_state(), empty()
    handle = objects.add_object(toy_prior(), state)
    objects.observe(handle, views_of(state, [0.3])[0], camera=X(3))
    with pytest.raises(SolveError, match="x3"):
        objects.optimize(SHORT)
    with pytest.raises(FactorError, match="chair 0: the values hold no camera at x3"):
        objects.views(handle)
    objects.values.insert(X(3), np.zeros(3))
    with pytest.raises(FactorError, match="chair 0: the values hold no camera at x3"):
        objects.views(handle)


def own_slam() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Two cameras and a landmark of the caller's, some way from their optimum."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    T = views_of(toy_state(), [0.3])[0].T_world_camera
    step = gtsam.Pose3(gtsam.Rot3.Rz(0.1), np.array([0.3, 0.0, 0.1]))
    graph.push_back(gtsam.PriorFactorPose3(X(0), T, pose_noise(0.05, 0.05)))
    graph.push_back(gtsam.BetweenFactorPose3(X(0), X(1), step, pose_noise(0.02, 0.03)))
    for k in (0, 1):
        sight = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
        graph.push_back(
            gtsam.BearingRangeFactor3D(
                X(k), L(0), gtsam.Unit3(np.array([0.1, 0.2, 1.0])), 2.0 + 0.1 * k, sight
            )
        )
    values.insert(X(0), T.retract(NEAR))
    values.insert(X(1), T.compose(step).retract(-NEAR))
    values.insert(L(0), T.transformFrom(np.array([0.3, 0.3, 1.8])))
    return graph, values


def worthless(view: ObjectView) -> ObjectView:
    """Seen by a sensor that tells nothing."""
    sigma, rays = (
        np.full(len(view.points_sigma), 1e6),
        replace(view.rays, sigma=np.full(len(view.rays.sigma), 1e6)),
    )
    return replace(view, points_sigma=sigma, rays=rays)


@pytest.mark.parametrize("informs", [False, True])
def test_an_object_without_information_leaves_the_caller_s_variables_alone(informs):
    plain = ObjectGraph(*own_slam())
    exact = SolverConfig(
        slopes=(200.0,), rounds=2, inner=LevenbergMarquardtConfig(iterations=60, relative_tolerance=0.0)
    )
    plain.optimize(exact)
    objects = ObjectGraph(*own_slam(), up_world=UP)
    own_factors = objects.graph.size()
    state = toy_state()
    handle = objects.add_object(toy_prior(), state)
    for k, view in enumerate(views_of(state, [0.3, 0.5])):
        objects.observe(handle, view if informs else worthless(view), camera=X(k))
    assert [objects.graph.at(i).keys() for i in range(own_factors)] == [
        plain.graph.at(i).keys() for i in range(own_factors)
    ]
    # anything may hold the object: it must be determined without views too
    objects.graph.push_back(
        gtsam.PriorFactorPose3(handle.keys.pose, state.T_world_object, pose_noise(0.01, 0.01))
    )
    objects.optimize(exact)
    moves = [
        np.abs(plain.values.atPose3(X(k)).localCoordinates(objects.values.atPose3(X(k)))).max()
        for k in (0, 1)
    ]
    moves.append(np.abs(plain.values.atPoint3(L(0)) - objects.values.atPoint3(L(0))).max())
    if informs:
        assert min(moves) > 1e-3  # the same object with information does move them
    else:
        assert max(moves) < 1e-8


def factors_of(graph: gtsam.NonlinearFactorGraph) -> list[tuple[int, gtsam.NonlinearFactor]]:
    return [(i, graph.at(i)) for i in range(graph.size()) if graph.exists(i)]


def test_what_was_added_can_be_taken_out_again():
    objects = ObjectGraph(*own_slam(), up_world=UP, floor=0.0)
    before, values = factors_of(objects.graph), gtsam.Values(objects.values)
    state = toy_state()
    views = views_of(state, [0.3, 0.5])
    first = objects.add_object(toy_prior(), state)
    objects.observe(first, views[0], camera=X(0))
    objects.graph.push_back(
        gtsam.PriorFactorPose3(X(1), gtsam.Pose3(), pose_noise(1, 1))
    )  # the caller goes on
    second = objects.add_object(toy_prior(), moved(state, 1.0))
    objects.stand_on_floor(second)
    objects.observe(second, views[1], camera=X(1))

    objects.remove_object(first)
    assert objects.objects == [second]
    assert not any(objects.values.exists(key) for key in first.keys)
    assert objects.graph.error(objects.values) > 0  # nothing is left on what is gone
    objects.remove_object(second)
    after = factors_of(objects.graph)
    assert after[:-1] == before
    assert after[-1][1].keys() == [X(1)]
    assert objects.values.equals(values, 0.0)
    with pytest.raises(FactorError, match="not in this graph"):
        objects.remove_object(first)


def test_a_view_can_be_taken_out_again():
    state, objects = toy_state(), empty()
    views = views_of(state, [0.3, 0.5, 2.0])
    handle = objects.add_object(toy_prior(), state.retract(0.3 * OFF))
    objects.observe(handle, views[0])
    objects.graph.push_back(gtsam.PriorFactorPose3(handle.keys.pose, state.T_world_object, pose_noise(1, 1)))
    objects.observe(handle, views[1])
    one, factors = objects.graph.error(objects.values), list(handle.factors)
    objects.observe(handle, views[2])
    objects.remove_view(handle, views[2])
    assert handle.factors == factors
    assert [each.view for each in handle.sightings] == views[:2]
    assert objects.graph.error(objects.values) == one
    # of one in the middle the slots stay empty, and nobody else's factors move
    objects.remove_view(handle, views[0])
    assert [slot for slot in handle.slots if not objects.graph.exists(slot)] == []
    assert len(objects.views(handle)) == 1
    assert handle.factors == factors[-2:]
    objects.optimize(SHORT)
    with pytest.raises(FactorError, match="chair 0 was not observed in this view"):
        objects.remove_view(handle, views[0])


def test_a_view_whose_factors_are_not_there_any_more_is_not_taken_out():
    objects = empty()
    handle = objects.add_object(toy_prior(), toy_state())
    view = views_of(toy_state(), [0.3])[0]
    objects.observe(handle, view)
    slots, sightings = dict(handle.slots), list(handle.sightings)
    objects.graph.resize(objects.graph.size() - 1)
    with pytest.raises(FactorError, match="chair 0: the graph was shortened"):
        objects.remove_view(handle, view)
    assert (handle.slots, handle.sightings) == (slots, sightings)
    with pytest.raises(FactorError, match="not in this graph"):
        empty().remove_view(handle, view)


def test_a_view_whose_factors_were_added_otherwise_is_not_taken_out():
    """As in the graph that an incremental map gives: without its factors a view must not be forgotten."""
    objects = empty()
    handle = objects.add_object(toy_prior(), toy_state())
    view = views_of(toy_state(), [0.3])[0]
    factors = objects.builder.view(handle.prior, handle.keys, view, view.T_world_camera, None)
    objects.add_factors(handle, factors)
    handle.sightings.append(Sighting(view, view.T_world_camera, None))
    size = objects.graph.size()
    with pytest.raises(FactorError, match="chair 0: the view's factors came otherwise than by `observe`"):
        objects.remove_view(handle, view)
    assert (objects.graph.size(), len(handle.sightings)) == (size, 1)


def test_the_graph_is_as_long_as_before_once_everything_is_taken_out():
    objects = ObjectGraph(*own_slam(), up_world=UP)
    size = objects.graph.size()
    handles = [objects.add_object(toy_prior(), toy_state()) for _ in range(2)]
    for handle in handles:
        objects.remove_object(handle)
    assert objects.graph.size() == size


def test_names_and_the_numbers_in_them_are_free_where_objects_were_taken_out():
    objects = empty()
    first, table = (
        objects.add_object(replace(toy_prior(), category=kind), toy_state()) for kind in ("chair", "table")
    )
    objects.remove_object(first)
    another = objects.add_object(toy_prior(), toy_state())
    assert (table.name, another.name) == ("table 1", "chair 2")
    assert objects.add_object(toy_prior(), toy_state(), name="lamp").name == "lamp"
    assert objects.add_object(toy_prior(), toy_state()).name == "chair 3"


def test_an_object_that_the_caller_holds_stays():
    objects = empty(up_world=None)
    handle = objects.add_object(toy_prior(), toy_state())
    objects.graph.push_back(gtsam.PriorFactorPose3(handle.keys.pose, gtsam.Pose3(), pose_noise(1, 1)))
    size = objects.graph.size()
    with pytest.raises(FactorError, match=r"your factor 2 on o0"):
        objects.remove_object(handle)
    assert objects.graph.size() == size
    assert objects.objects == [handle]
    objects.graph.remove(0)
    with pytest.raises(FactorError, match="rearranged"):
        objects.remove_object(handle)


def test_a_factor_that_the_caller_has_put_in_the_place_of_another_is_not_taken_out():
    objects = empty(up_world=None)
    handle = objects.add_object(toy_prior(), toy_state())
    (slot,) = (i for i, factor in handle.slots.items() if factor.keys() == [handle.keys.log_scale])
    own = gtsam.PriorFactorVector(handle.keys.log_scale, np.zeros(3), gtsam.noiseModel.Unit.Create(3))
    objects.graph.replace(slot, own)
    with pytest.raises(FactorError, match=f"chair 0: .* its factor {slot} is another one now"):
        objects.remove_object(handle)
    assert objects.graph.at(slot) is own
    assert objects.objects == [handle]


def test_an_object_whose_factors_were_cut_off_is_not_removed():
    objects = empty()
    handle = objects.add_object(toy_prior(), toy_state())
    objects.graph.resize(0)
    with pytest.raises(FactorError, match="chair 0: the graph was shortened"):
        objects.remove_object(handle)
    assert objects.objects == [handle]


def test_factors_of_another_object_are_refused():
    objects = empty()
    handles = [objects.add_object(toy_prior(), toy_state()) for _ in range(2)]
    factors = objects.builder.box(replace(toy_prior(), box=np.ones(3)), handles[1].keys)
    before = objects.graph.size()
    wrong: list[tuple[Any, str]] = [
        (factors, r"factors\[0\] is of another object, o1"),
        ([42], "must be of type"),
    ]
    for given, message in wrong:
        with pytest.raises(FactorError, match=f"chair 0: .*{message}"):
            objects.add_factors(handles[0], given)
    assert objects.graph.size() == before


@pytest.mark.parametrize("lean", [np.pi, np.radians(100)])
def test_a_start_on_its_head_is_refused_where_up_is_known(lean):
    state = toy_state()
    turned = state.T_world_object.compose(gtsam.Pose3(gtsam.Rot3.Rx(lean), np.zeros(3)))
    fallen = replace(state, T_world_object=turned)
    objects = empty()
    with pytest.raises(FactorError, match=f"o0: .* leans {np.degrees(lean):.0f} degrees from up_world"):
        objects.add_object(toy_prior(), fallen)
    assert objects.values.size() == objects.graph.size() == 0
    empty(up_world=None).add_object(toy_prior(), fallen)
