"""GTSAM's traps that no other test springs: each must end in a clear error or a right answer.

Elsewhere: what a guarded factor refuses when it is linearised (factors/test_reduce.py, factors/test_observation_factors.py),
GTSAM's own optimiser beside ours (test_solve.py), missing priors (test_covariance.py, test_diagnostics.py), the
caller's optimiser after `refresh` and one part's failure beside the others (test_graph.py), and ISAM2's: half updates, the
newest camera's place, relinearisation, what refers to its insides, slots used again (test_incremental_smoother.py), and objects
that start far off (test_incremental_entry.py).
"""

import copy
import gc
import pickle
import tomllib
import warnings
from pathlib import Path

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import X

from factors.base import Annealing, ObservationFactor
from factors.errors import FactorError
from factors.reduce import guarded_factor
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from objgraph.graph.object_graph import ObjectGraph
from objgraph.observation.sampling import SamplingConfig, observe
from tests.toys import ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=60, hits=30, free=30)
OPTIMISERS = [gtsam.LevenbergMarquardtOptimizer, gtsam.GaussNewtonOptimizer, gtsam.DoglegOptimizer]


def seen_chair(code: float | None = None) -> ObjectGraph:
    """A toy chair in one view whose camera has a key and a prior."""
    state = toy_state()
    view = observe(toy_frame([state], 0.3), 1, SAMPLING)
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP)
    handle = objects.add_object(toy_prior(), state.retract(np.full(13, 0.02)))
    objects.values.insert(X(0), view.T_world_camera)
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.01)
    objects.graph.push_back(gtsam.PriorFactorPose3(X(0), view.T_world_camera, noise))
    objects.observe(handle, view, camera=X(0))
    objects.refresh(Annealing(120.0))
    if code is not None:
        objects.values.update(handle.keys.code, np.full(4, code))
    return objects


class OwnError(Exception):
    """One that only the test knows."""


def failing_graph(error: Exception, after: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """A guarded factor that raises at its call number `after`."""
    calls = []

    def evaluate(values, jacobian):
        calls.append(jacobian)
        if len(calls) > after:
            raise error
        x = values.atVector(X(0))
        return np.concatenate([x - 5.0, x**2]), [np.array([[1.0], [2.0 * x[0]]])]

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(guarded_factor([X(0)], [1], 2, evaluate, "F"))
    values.insert(X(0), np.zeros(1))
    return graph, values


@pytest.mark.parametrize("after", [0, 1, 2])
@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_an_exception_in_a_factor_keeps_its_type_through_the_optimisers(optimiser, after):
    error = OwnError("mine")
    with pytest.raises(OwnError) as caught:
        optimiser(*failing_graph(error, after)).optimize()
    assert caught.value is error


def test_an_exception_in_a_factor_keeps_its_type_through_isam2_and_marginals():
    for act in (lambda g, v: gtsam.ISAM2().update(g, v), gtsam.Marginals):
        with pytest.raises(OwnError, match="mine"):
            act(*failing_graph(OwnError("mine"), 0))


@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_what_is_not_finite_is_an_error_and_not_the_start_returned(optimiser):
    """GTSAM's optimisers take a NaN cost for convergence."""
    objects = seen_chair(code=np.nan)
    with pytest.raises(FactorError, match=r"Factor\(o0, s0, z0, x0\): .* not finite"):
        optimiser(objects.graph, objects.values).optimize()


@pytest.mark.parametrize(
    ("residual", "message"),
    [
        (np.zeros(2), r"F\(x0\): the residual is float64 \(2,\), not float64 \(3,\)"),
        (np.zeros((3, 1)), r"the residual is float64 \(3, 1\)"),
        (np.array([0.0, np.nan, np.inf]), "2 entries that are not finite"),
        ([0.0, 0.0, 0.0], "the residual is list"),
        (None, "the residual is NoneType"),
    ],
)
def test_a_wrong_residual_is_refused_where_only_the_cost_is_asked_for(residual, message):
    factor = guarded_factor([X(0)], [2], 3, lambda values, jacobian: (residual, None), "F")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(factor)
    values.insert(X(0), np.zeros(2))
    with pytest.raises(FactorError, match=message):
        graph.error(values)


def test_one_bad_point_does_not_silence_the_others():
    """A robust noise model would weigh the whole factor by its norm; rows are weighed one by one instead."""
    state, keys = toy_state(), ObjectKeys.numbered(0)
    view = observe(toy_frame([state], 0.3), 1, SAMPLING)
    T_camera, values = view.T_world_camera, gtsam.Values()
    state.insert(values, keys)

    def normal_equations(aside: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Hessian, and gradient w.r.t. the object's place, with one more point this far above the chair."""
        points = view.points_camera
        if aside is not None:
            above = state.to_world(np.array([[0.0, 0.5, 0.24]]))[0] + aside * UP
            points = np.concatenate([points, T_camera.transformTo(above)[None]])
        sigma = np.full(len(points), 0.005)
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(SurfaceFactor(keys, ToyDecoder().double(), T_camera, points, sigma).gtsam_factor())
        H, negative_gradient = graph.linearize(values).hessian()
        return H, negative_gradient[3:6]

    H, pull = normal_equations(None)
    H_near, pull_near = normal_equations(0.5)
    _, pull_far = normal_equations(5.0)
    assert np.linalg.eigvalsh(H_near - H).min() > -1e-6 * np.linalg.eigvalsh(H).max()
    outlier = np.linalg.norm(pull_near - pull)
    assert outlier > 0
    assert np.linalg.norm(pull_far - pull_near) < 0.02 * outlier  # it does not pull harder from farther away


def test_a_graph_with_decoder_factors_cannot_be_copied_by_accident():
    """Cloning, pickling and serialising fail aloud, and leave the graph as it was."""
    objects = seen_chair()
    before = objects.graph.error(objects.values)
    for copying in (
        lambda: objects.graph.clone(),
        lambda: objects.graph.at(objects.graph.size() - 1).clone(),
        lambda: objects.graph.serialize(),
        lambda: pickle.dumps(objects.graph),
        lambda: copy.deepcopy(objects.graph),
        lambda: objects.graph.at(objects.graph.size() - 1).rekey([1, 2, 3, 4]),
    ):
        with pytest.raises((RuntimeError, TypeError), match=r"clone|pickle|not registered"):
            copying()
    assert objects.graph.error(objects.values) == before


def linear_system(factor: ObservationFactor, values: gtsam.Values) -> tuple[np.ndarray, np.ndarray]:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor.gtsam_factor())
    return graph.linearize(values).jacobian()


@pytest.mark.parametrize("i", [0, 1])
def test_a_factor_is_built_again_from_its_specification(i):
    """What GTSAM cannot copy is kept as an object that can be copied, and makes the same factor again."""
    objects = seen_chair()
    factor = objects.objects[0].factors[i]
    twin = copy.deepcopy(factor)
    A, b = linear_system(factor, objects.values)
    for other in (factor, twin):
        A_other, b_other = linear_system(other, objects.values)
        np.testing.assert_array_equal(A_other, A)
        np.testing.assert_array_equal(b_other, b)
    moved = gtsam.Values(objects.values)
    state = toy_state().retract(np.full(13, -0.05))
    state.update(moved, objects.objects[0].keys)
    twin.refresh(moved, Annealing(400.0))
    assert twin.loss(objects.values) != factor.loss(objects.values)
    np.testing.assert_array_equal(linear_system(factor, objects.values)[1], b)


def test_nothing_is_kept_of_values_that_die_with_the_next_iteration():
    """`optimiser.values()` refers to the optimiser's own; states and frozen factors must not."""
    objects = seen_chair()
    (handle,) = objects.objects
    optimiser = gtsam.LevenbergMarquardtOptimizer(objects.graph, objects.values)
    optimiser.iterate()
    safe = gtsam.Values(optimiser.values())
    state = ObjectState.from_values(optimiser.values(), handle.keys)
    camera = handle.factors[0].T_world_camera(optimiser.values())
    for factor in handle.factors:
        factor.refresh(optimiser.values(), Annealing(120.0))
    losses = [factor.loss(safe) for factor in handle.factors]
    for _ in range(3):
        optimiser.iterate()
    assert not optimiser.values().equals(safe, 1e-9)  # or nothing could have been overwritten
    del optimiser
    gc.collect()
    kept = gtsam.Values()
    state.insert(kept, handle.keys)
    kept.insert(X(0), camera)
    for key in (*handle.keys, X(0)):
        assert safe.extract([key]).equals(kept.extract([key]), 0.0)
    assert [factor.loss(kept) for factor in handle.factors] == losses


@pytest.fixture
def torch_warns_always():
    torch.set_warn_always(True)
    yield
    torch.set_warn_always(False)


@pytest.mark.usefixtures("torch_warns_always")
def test_read_only_views_never_reach_torch():
    """GTSAM's `translation()` is a view that torch would let be written to, with a warning."""
    T = toy_state().T_world_object
    with pytest.raises(ValueError, match="read-only"):
        T.translation()[0] = 2.0
    with pytest.warns(UserWarning, match="not writable"):
        torch.as_tensor(T.translation())
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        objects = seen_chair()
        objects.graph.linearize(objects.values)
        objects.marginals(objects.objects[0])
        state = objects.state(objects.objects[0])
        before = state.matrix
        for array in (state.matrix, state.scale, state.xi_world_object):
            array *= 2.0
        np.testing.assert_array_equal(state.matrix, before)
        assert T.equals(toy_state().T_world_object, 0.0)


def test_the_wheels_that_crash_are_ruled_out():
    """GTSAM 4.2 crashes with numpy 2; open3d 0.20 needs a library that a bare machine lacks."""
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    wanted = {"gtsam>=4.3.0", "numpy>=2.0", "open3d>=0.19,<0.20"}
    assert wanted <= set(project["dependencies"])
