"""What is undetermined is found and named: keys, directions and what would determine them."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.base import Annealing
from factors.keys import readable_key
from factors.priors import code_prior, scale_prior
from factors.state import ObjectKeys
from objgraph.diagnostics import null_space as null_space_module
from objgraph.diagnostics.null_space import null_space, scaled_jacobian
from objgraph.diagnostics.undetermined import (
    Undetermined,
    check_determined,
    explanation,
    loose_directions,
    undetermined,
)
from objgraph.errors import SolveError
from objgraph.graph import ObjectGraph
from objgraph.keys import roles
from objgraph.linear import tangent_dims
from objgraph.sampling import SamplingConfig, observe
from objgraph.solve import Problem, SolverConfig, solve
from tests.toys import toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=80, hits=40, free=40)
TENTH = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
EVERY_TRANSLATION, EVERY_ROTATION = "translation in every direction", "rotation about every axis"


def two_chairs(up: bool = True, camera_keys: bool = True) -> ObjectGraph:
    """Two toy chairs in two views, whose cameras are unknown."""
    first, second = toy_state(), toy_state(1.0)
    T = second.T_world_object
    aside = gtsam.Pose3(T.rotation(), T.translation() + np.array([1.2, 0, 0]))
    states = [first, replace(second, T_world_object=aside)]
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values())
    handles = [objects.add_object(toy_prior(), s, up_world=UP if up else None) for s in states]
    for k, azimuth in enumerate((0.3, 2.0)):
        frame = toy_frame(states, azimuth, str(k), seed=k)
        for i, handle in enumerate(handles):
            view = observe(frame, i + 1, SAMPLING)
            if camera_keys and i == 0:
                objects.values.insert(X(k), view.T_world_camera)
            objects.observe(handle, view, camera=X(k) if camera_keys else None)
    objects.refresh(Annealing(200.0))
    return objects


def chain(n: int, held: bool = False) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Odometry along a bent line far from the world's origin."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(n):
        turn = gtsam.Rot3.RzRyRx(0.1 * i, 0.2, 0.03 * i)
        values.insert(X(i), gtsam.Pose3(turn, np.array([100.0 + i, 0.3 * i * i / n, 0.1 * i])))
        if i:
            step = values.atPose3(X(i - 1)).between(values.atPose3(X(i)))
            graph.push_back(gtsam.BetweenFactorPose3(X(i - 1), X(i), step, TENTH))
    if held:
        graph.push_back(gtsam.PriorFactorPose3(X(0), values.atPose3(X(0)), TENTH))
    return graph, values


def projections(known_distance: bool) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Three cameras that see the pixels of twelve points."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    calibration, pixel = gtsam.Cal3_S2(500, 500, 0, 320, 240), gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
    points = np.random.default_rng(0).normal(size=(12, 3)) + [0, 0, 6]
    for j, point in enumerate(points):
        values.insert(L(j), point)
    for i in range(3):
        T_world_camera = gtsam.Pose3(gtsam.Rot3.Ry(0.1 * i), np.array([0.5 * i, 0.1 * i * i, 0]))
        values.insert(X(i), T_world_camera)
        camera = gtsam.PinholeCameraCal3_S2(T_world_camera, calibration)
        for j, point in enumerate(points):
            graph.push_back(
                gtsam.GenericProjectionFactorCal3_S2(camera.project(point), pixel, X(i), L(j), calibration)
            )
    graph.push_back(gtsam.PriorFactorPose3(X(0), values.atPose3(X(0)), TENTH))
    if known_distance:
        away = gtsam.noiseModel.Isotropic.Sigma(1, 0.1)
        graph.push_back(gtsam.RangeFactorPose3(X(0), X(1), 0.5, away))
    return graph, values


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


def test_an_object_without_views_is_named_beside_what_moves_together():
    objects = two_chairs()
    lonely = objects.add_object(toy_prior(), toy_state(), up_world=UP)
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


def test_two_islands_are_two_findings():
    graph, values = chain(4)
    more, others = chain(3)
    for i in range(3):
        values.insert(X(10 + i), others.atPose3(X(i)))
    graph.push_back(more.at(0).rekey([X(10), X(11)]))
    graph.push_back(more.at(1).rekey([X(11), X(12)]))
    found = undetermined(graph, values)
    assert [(len(item.keys), item.dof) for item in found] == [(4, 6), (3, 6)]


def test_a_range_leaves_a_pose_on_a_sphere():
    """A pose of which only the distance is known: it can turn alone, and move across the line of sight."""
    graph, values = chain(3, held=True)
    graph.push_back(gtsam.RangeFactorPose3(X(0), X(3), 1.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    values.insert(X(3), gtsam.Pose3(gtsam.Rot3(), values.atPose3(X(0)).translation() + [0, 0, 2.0]))
    (found,) = undetermined(graph, values)
    assert (found.keys, found.dof) == ((X(3),), 5)
    assert found.direction == (
        f"{EVERY_TRANSLATION} across z of the camera frame, m; {EVERY_ROTATION} of the camera frame, rad"
    )


def test_pictures_without_a_known_distance_do_not_know_their_size():
    (found,) = undetermined(*projections(known_distance=False))
    assert found.dof == 1
    assert found.direction == "size of everything"
    assert found.missing == "a known distance"
    assert len(found.keys) == 15


def vector_graph(code_rows, scale_rows) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, ObjectKeys]:
    """Linear measurements of one object's code (4) and log-scale."""
    keys, graph, values = ObjectKeys.numbered(0), gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, rows in ((keys.code, np.atleast_2d(code_rows)), (keys.log_scale, np.atleast_2d(scale_rows))):
        d = rows.shape[1]
        values.insert(key, np.zeros(d))

        def error(this, v, H, A=rows, k=key):
            if H is not None:
                H[0] = np.asfortranarray(A)
            return A @ v.atVector(k)

        graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(rows)), [key], error))
    return graph, values, keys


@pytest.mark.parametrize(
    ("code_rows", "scale_rows", "expected"),
    [
        (np.eye(4)[:3], np.eye(3), [("z0", "code direction, mostly code_3", "a code prior", 1)]),
        (np.eye(4)[1:3], np.eye(3), [("z0", "2 directions of the code, mostly code_0, code_3", "a code prior", 2)]),
        (np.zeros((1, 4)), np.eye(3), [("z0", "the whole code", "a code prior", 4)]),
        (np.eye(4), np.eye(3)[1:], [("s0", "log_scale_x", "a scale prior", 1)]),
        (np.eye(4), [[1, -1, 0], [0, 1, -1]], [("s0", "the common log-scale of all axes", "a scale prior", 1)]),
        (np.eye(4), [[1.0, 1.0, 1.0]], [("s0", "log_scale_x and log_scale_y and log_scale_z", "a scale prior", 2)]),
        (
            np.eye(4)[:3],
            np.zeros((1, 3)),
            [
                ("s0", "log-scale of every axis", "a scale prior", 3),
                ("z0", "code direction, mostly code_3", "a code prior", 1),
            ],
        ),
    ],
)  # fmt: skip
def test_directions_of_code_and_scale(code_rows, scale_rows, expected):
    graph, values, _ = vector_graph(code_rows, scale_rows)
    found = undetermined(graph, values)
    assert [(readable_key(u.key), u.direction, u.missing, u.dof) for u in found] == expected


def test_either_of_two_coupled_priors_will_do():
    """Size told apart from shape by neither: holding one holds both."""
    graph, values, keys = vector_graph(np.eye(4)[1:], np.eye(3)[1:])

    def error(this, v, H):
        if H is not None:
            H[0], H[1] = np.asfortranarray([[1.0, 0, 0, 0]]), np.asfortranarray([[2.0, 0, 0]])
        return np.array([v.atVector(keys.code)[0] + 2 * v.atVector(keys.log_scale)[0]])

    graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [keys.code, keys.log_scale], error))
    (found,) = undetermined(graph, values)
    assert set(found.keys) == {keys.code, keys.log_scale}
    assert found.missing == "a scale prior or a code prior"
    assert "move together" in str(found)
    for prior in (code_prior(keys, np.zeros(4), np.eye(4)), scale_prior(keys, 0.0, 0.3, 0.1)):
        held = gtsam.NonlinearFactorGraph(graph)
        held.push_back(prior)
        assert undetermined(held, values) == []


def test_objects_on_keys_of_the_caller_s_own_are_known_as_objects():
    own, graph, values = ObjectKeys(17, L(0), L(1)), gtsam.NonlinearFactorGraph(), gtsam.Values()
    toy_state().insert(values, own)
    hold = gtsam.PriorFactorPose3(own.pose, toy_state().T_world_object, TENTH)
    graph.push_back(hold)
    found = undetermined(graph, values, [own])
    assert {item.key: item.missing for item in found} == {
        own.log_scale: "a scale prior",
        own.code: "a code prior",
    }


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.floats(-3, 3), st.floats(-3, 3))
def test_the_finding_does_not_depend_on_units_or_axes(seed, log_rotation, log_translation):
    """A pose known in three directions out of six: three are missing, whatever the sizes and the directions."""
    rng = np.random.default_rng(seed)
    weight = 10.0 ** np.repeat([log_rotation, log_translation], 3)
    turned = np.kron(np.eye(2), np.linalg.qr(rng.normal(size=(3, 3)))[0])
    A = rng.normal(size=(3, 6)) @ turned * weight

    def error(this, v, H):
        if H is not None:
            H[0] = np.asfortranarray(A)
        return np.zeros(3)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [X(0)], error))
    values.insert(X(0), gtsam.Pose3())
    assert sum(item.dof for item in undetermined(graph, values)) == 3


@pytest.mark.parametrize("weakest", [3e-6, 1e-8])
def test_the_threshold(weakest):
    """Weak information is information, down to what single precision leaves of none."""
    graph, values, _ = vector_graph(np.diag([1.0, 1.0, 1.0, weakest]), np.eye(3))
    assert bool(undetermined(graph, values)) == (weakest < 1e-6)
    assert undetermined(graph, values, tolerance=1e-9) == []
    (loosest,) = loose_directions(graph.linearize(values), values, at_least=1)
    assert loosest.direction == "code direction, mostly code_3"


def test_sparse_and_dense_find_the_same_space(monkeypatch):
    graph, values = chain(12)
    graph.push_back(gtsam.RangeFactorPose3(X(0), X(30), 1.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    values.insert(X(30), gtsam.Pose3(gtsam.Rot3(), np.array([3.0, 3.0, 3.0])))
    linear = graph.linearize(values)
    dims = tangent_dims(linear)
    jacobian = scaled_jacobian(linear, dims, roles(dims, values))
    dense = null_space(jacobian.matrix)
    monkeypatch.setattr(null_space_module, "_DENSE", 0)
    sparse = null_space(jacobian.matrix)
    assert dense.shape == sparse.shape == (78, 11)
    np.testing.assert_allclose(dense @ dense.T, sparse @ sparse.T, atol=1e-7)
    assert np.abs(jacobian.matrix @ sparse).max() < 1e-9


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
