"""Directions that nothing determines: found whatever the units, and told apart from what is known a little."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, V, X
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.keys import readable_key
from factors.priors import code_prior, scale_prior
from factors.state import ObjectKeys
from objgraph.diagnostics import null_space as null_space_module
from objgraph.diagnostics.keys import roles
from objgraph.diagnostics.linear import tangent_dims
from objgraph.diagnostics.null_space import null_space, scaled_jacobian
from objgraph.diagnostics.undetermined import (
    loose_directions,
    undetermined,
)
from objgraph.observation.sampling import SamplingConfig
from tests.objgraph.diagnostics.undetermined_graphs import TENTH, chain, inertial, projections
from tests.toys import toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=80, hits=40, free=40)
EVERY_TRANSLATION, EVERY_ROTATION = "translation in every direction", "rotation about every axis"


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


def test_an_inertial_trajectory_moves_freely_but_for_its_lean():
    """Velocities turn along and do not shift; as points they would hide both motions."""
    graph, values = inertial(5)
    (found,) = undetermined(graph, values)
    assert found.dof == 4
    assert found.direction == (
        f"{EVERY_TRANSLATION} of the world frame, m; rotation about z of the world frame, rad"
    )
    assert found.missing == "a PriorFactorPose3 on one camera or a fixed camera"
    values.insert(V(9), np.zeros(3))
    alone = undetermined(graph, values)[-1]
    assert str(alone) == (
        "v9 (no factor is on it: velocity in every direction of the world frame, m/s): it needs a prior on the velocity"
    )


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
