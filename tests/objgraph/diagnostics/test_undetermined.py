"""What is undetermined is found and named: keys, directions and what would determine them."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from factors.base import Annealing
from factors.keys import readable_key
from objgraph.diagnostics import null_space as null_space_module
from objgraph.diagnostics.undetermined import (
    Undetermined,
    check_determined,
    explanation,
    undetermined,
)
from objgraph.errors import SolveError
from objgraph.graph.object_graph import ObjectGraph
from objgraph.graph.solve import Problem, SolverConfig, solve
from objgraph.observation.sampling import SamplingConfig, observe
from tests.objgraph.diagnostics.undetermined_graphs import TENTH, chain, projections
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=80, hits=40, free=40)
EVERY_TRANSLATION, EVERY_ROTATION = "translation in every direction", "rotation about every axis"


def two_chairs(up: bool = True, camera_keys: bool = True) -> ObjectGraph:
    """Two toy chairs in two views, whose cameras are unknown."""
    first, second = toy_state(), toy_state(1.0)
    T = second.T_world_object
    aside = gtsam.Pose3(T.rotation(), T.translation() + np.array([1.2, 0, 0]))
    states = [first, replace(second, T_world_object=aside)]
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP if up else None)
    handles = [objects.add_object(toy_prior(), s) for s in states]
    for k, azimuth in enumerate((0.3, 2.0)):
        frame = toy_frame(states, azimuth, str(k), seed=k)
        for i, handle in enumerate(handles):
            view = observe(frame, i + 1, SAMPLING)
            if camera_keys and i == 0:
                objects.values.insert(X(k), view.T_world_camera)
            objects.observe(handle, view, camera=X(k) if camera_keys else None)
    objects.refresh(Annealing(200.0))
    return objects


def test_a_determined_graph_has_nothing_to_report():
    objects = two_chairs(camera_keys=False)
    assert undetermined(objects.graph, objects.values) == []
    check_determined(objects.graph, objects.values)
    check_determined(*chain(5, held=True))
    check_determined(*projections(known_distance=True))


@pytest.mark.parametrize(
    ("up", "turning", "dof"), [(True, "rotation about z", 4), (False, EVERY_ROTATION, 6)]
)
def test_without_a_fixed_camera_everything_moves_together(up, turning, dof):
    objects = two_chairs(up)
    (found,) = undetermined(objects.graph, objects.values)
    assert found.keys == (X(0), X(1), *(handle.keys.pose for handle in objects.objects))
    assert found.dof == dof
    assert found.direction == (
        f"{EVERY_TRANSLATION} of the world frame, m; {turning} of the world frame, rad"
    )
    assert found.missing == "a PriorFactorPose3 on one camera or a fixed camera"
    assert str(found).startswith("x0, x1, o0, o1, which move together (translation")
    hold = gtsam.PriorFactorPose3(X(1), objects.values.atPose3(X(1)), TENTH)
    objects.graph.push_back(hold)
    assert undetermined(objects.graph, objects.values) == []


@pytest.mark.parametrize("lean", [0.02, 0.3])
def test_objects_that_lean_tell_no_heading(lean):
    objects = two_chairs()
    for handle in objects.objects:
        T = objects.values.atPose3(handle.keys.pose)
        objects.values.update(handle.keys.pose, T.compose(gtsam.Pose3(gtsam.Rot3.Rx(lean), np.zeros(3))))
    objects.refresh(Annealing(200.0))
    (found,) = undetermined(objects.graph, objects.values)
    assert found.dof == 4
    assert "rotation about z" in found.direction


def test_an_object_without_views_is_named_beside_what_moves_together():
    objects = two_chairs()
    lonely = objects.add_object(toy_prior(), toy_state())
    alone, together = undetermined(objects.graph, objects.values)
    assert alone.keys == (lonely.keys.pose,)
    assert alone.dof == 4
    assert (
        alone.direction
        == f"{EVERY_TRANSLATION} of the object frame, m; rotation about y of the object frame, rad"
    )
    assert alone.missing == "views of the object or a pose prior"
    assert set(together.keys) == {X(0), X(1), *(handle.keys.pose for handle in objects.objects[:2])}


def test_a_variable_without_any_factor_is_named():
    graph, values = chain(3, held=True)
    values.insert(X(7), gtsam.Pose3())
    (found,) = undetermined(graph, values)
    assert (found.key, found.dof) == (X(7), 6)
    assert found.direction.startswith(f"no factor is on it: {EVERY_TRANSLATION}")


def test_a_factor_on_a_variable_without_a_value_is_named():
    graph, values = chain(3)
    values.erase(X(1))
    with pytest.raises(SolveError, match="factors on x1, which is not in the values: insert"):
        undetermined(graph, values)


@pytest.mark.parametrize("n", [4, 90])
def test_a_floating_trajectory(n):
    """90 poses are decomposed as a sparse matrix, 4 as a dense one."""
    assert (6 * n > null_space_module._DENSE) == (n == 90)
    graph, values = chain(n)
    (found,) = undetermined(graph, values)
    assert found.dof == 6
    assert set(found.keys) == set(values.keys())
    assert undetermined(*chain(n, held=True)) == []
    with pytest.raises(SolveError, match=rf"x0, x1, x2, x3.*{EVERY_TRANSLATION}.*a fixed camera$"):
        check_determined(graph, values)


@pytest.mark.parametrize("known", [1e-3, 1.0])
def test_a_long_straight_trajectory_is_held_by_one_end(known):
    """Three kilometres: what bends it whole is a share of 1e-7 of what each step says."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.01] * 3 + [0.02] * 3))
    step, graph, values = (
        gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0, 0])),
        gtsam.NonlinearFactorGraph(),
        gtsam.Values(),
    )
    for i in range(3000):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(), np.array([float(i), 0, 0])))
        if i:
            graph.push_back(gtsam.BetweenFactorPose3(X(i - 1), X(i), step, noise))
    (found,) = undetermined(graph, values)
    assert found.dof == 6
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, known)))
    assert undetermined(graph, values) == []


def test_two_islands_are_two_findings():
    graph, values = chain(4)
    more, others = chain(3)
    for i in range(3):
        values.insert(X(10 + i), others.atPose3(X(i)))
    graph.push_back(more.at(0).rekey([X(10), X(11)]))
    graph.push_back(more.at(1).rekey([X(11), X(12)]))
    found = undetermined(graph, values)
    assert [(len(item.keys), item.dof) for item in found] == [(4, 6), (3, 6)]


def test_an_explanation_of_many_stays_short():
    found = [Undetermined((X(i),), "rotation", "a prior", 3) for i in range(9)]
    assert explanation(found).count("rotation") == 4
    assert explanation(found).endswith("; and 5 more")


@pytest.mark.parametrize(
    ("key", "name"),
    [
        (X(12), "x12"),
        (42, "42"),
        (0, "0"),
        (gtsam.symbol("o", 3), "o3"),
        (2**63 + 5, str(2**63 + 5)),
        (gtsam.LabeledSymbol(ord("x"), ord("A"), 3).key(), "xA3"),
    ],
)
def test_readable_keys(key, name):
    assert readable_key(key) == name


def chair_problem(prior_on_pose: bool) -> Problem:
    """A chair that no view has seen yet."""
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values())
    handle = objects.add_object(toy_prior(), toy_state())
    noise = gtsam.noiseModel.Isotropic.Sigma(6 if prior_on_pose else 3, 0.1)
    T = toy_state().T_world_object.retract(np.full(6, 0.1))
    prior = (
        gtsam.PriorFactorPose3(handle.keys.pose, T, noise)
        if prior_on_pose
        else gtsam.PoseTranslationPrior3D(handle.keys.pose, T.translation(), noise)
    )
    objects.graph.push_back(prior)
    return Problem("chair", objects.graph, objects.values, [])


def test_the_solver_refuses_before_it_moves_anything_and_solves_the_others():
    loose, held = chair_problem(False), chair_problem(True)
    start = gtsam.Values(loose.values)
    solve([loose, held], SolverConfig(rounds=2), refuse_undetermined=True)
    assert loose.failure is not None
    assert loose.failure.startswith(
        f"the graph does not determine o0 ({EVERY_ROTATION} of the object frame, rad)"
    )
    assert loose.failure.endswith("views of the object or a pose prior")
    assert loose.values.equals(start, 0.0)
    assert held.failure is None
    assert held.cost < 0.5 * held.cost_initial
    # without the check damping hides it
    permissive = chair_problem(False)
    solve([permissive], SolverConfig(rounds=2))
    assert permissive.failure is None
    assert not permissive.values.equals(start, 1e-3)


def test_an_empty_graph_leaves_nothing_undetermined_but_variables_without_factors():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    assert undetermined(graph, values) == []
    check_determined(graph, values)
    values.insert(X(0), gtsam.Pose3())
    (found,) = undetermined(graph, values)
    assert (found.keys, found.dof) == ((X(0),), 6)


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("ask", [undetermined, check_determined])
def test_what_is_not_finite_is_not_told_as_undetermined(ask, number):
    graph, values = chain(3, held=True)
    graph.push_back(
        gtsam.PriorFactorPoint3(L(0), np.array([number, 0, 0]), gtsam.noiseModel.Isotropic.Sigma(3, 1))
    )
    values.insert(L(0), np.zeros(3))
    with pytest.raises(SolveError, match="the factor on l0 is not finite"):
        ask(graph, values)
    values.update(X(1), gtsam.Pose3(gtsam.Rot3(), np.array([number, 0, 0])))
    with pytest.raises(SolveError, match="the value of x1 is not finite"):
        ask(graph, values)
