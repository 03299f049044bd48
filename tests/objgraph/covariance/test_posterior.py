"""Covariances: the inverse of the whole Hessian, labelled axes, and what they mean on the surface."""

import gtsam
import numpy as np
import pytest
import torch
from gtsam.symbol_shorthand import X
from scipy.stats import chi2

from factors.base import Annealing
from factors.priors import code_prior, scale_prior, upright_prior
from factors.state import ObjectKeys
from objgraph.covariance.labelled import RIGID_AXES, ObjectCovariance
from objgraph.covariance.posterior import Posterior, marginals
from objgraph.covariance.surface import surface_sigma
from objgraph.errors import CovarianceError, SolveError
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.object_graph import ObjectGraph
from objgraph.maps.mapped_object import COVARIANCE_AXES
from objgraph.observation.sampling import SamplingConfig, observe
from objgraph.priors.mesh import extract_mesh
from tests.objgraph.diagnostics.undetermined_graphs import chain
from tests.toys import ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=120, hits=60, free=60)
CODE, RIGID = 4, 9


def chair_graph(camera_key: bool = False) -> ObjectGraph:
    """A toy chair at the truth, frozen, in two views; the first camera may be unknown."""
    state = toy_state()
    views = [observe(toy_frame([state], a, str(i), seed=i), 1, SAMPLING) for i, a in enumerate((0.3, 2.0))]
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), up_world=UP)
    handle = objects.add_object(toy_prior(), state)
    if camera_key:
        noise = gtsam.noiseModel.Diagonal.Sigmas([0.02] * 3 + [0.05] * 3)
        objects.values.insert(X(0), views[0].T_world_camera)
        objects.graph.push_back(gtsam.PriorFactorPose3(X(0), views[0].T_world_camera, noise))
    objects.observe(handle, views[0], camera=X(0) if camera_key else None)
    objects.observe(handle, views[1])
    objects.refresh(Annealing(200.0))
    return objects


def dense_information(objects: ObjectGraph, dims: dict[int, int]) -> np.ndarray:
    """The Hessian over `dims`, from every row before any reduction and the priors' own Jacobians."""
    start = dict(zip(dims, np.cumsum([0, *dims.values()]), strict=False))
    total = sum(dims.values())
    H = np.zeros((total, total))
    for factor in objects.objects[0].factors:
        columns = np.concatenate([start[k] + np.arange(dims[k]) for k in factor.keys])
        J = factor.rows(objects.values).jacobian.numpy()
        H[np.ix_(columns, columns)] += J.T @ J
    for i in range(objects.graph.size()):
        factor = objects.graph.at(i)
        if isinstance(factor, gtsam.CustomFactor):
            continue
        J, _ = factor.linearize(objects.values).jacobian()
        columns = np.concatenate([start[k] + np.arange(dims[k]) for k in list(factor.keys())])
        H[np.ix_(columns, columns)] += J.T @ J
    return H


@pytest.mark.parametrize("camera_key", [False, True])
def test_marginals_are_the_inverse_of_the_dense_hessian(camera_key):
    objects = chair_graph(camera_key)
    keys = objects.objects[0].keys
    dims = {keys.pose: 6, keys.log_scale: 3, keys.code: CODE} | ({X(0): 6} if camera_key else {})
    expected = np.linalg.inv(dense_information(objects, dims))
    found = objects.marginals(objects.objects[0]).matrix
    sigma = np.sqrt(np.diag(expected))[: RIGID + CODE]
    np.testing.assert_allclose(
        found / np.outer(sigma, sigma),
        expected[: RIGID + CODE, : RIGID + CODE] / np.outer(sigma, sigma),
        atol=1e-5,
    )
    if camera_key:
        joint = Posterior(objects.graph, objects.values).joint_covariance([X(0), keys.pose])
        order = [*range(13, 19), *range(6)]
        np.testing.assert_allclose(joint, expected[np.ix_(order, order)], rtol=1e-4, atol=1e-10)


def test_a_posterior_answers_for_every_object_as_the_graph_was():
    objects = chair_graph(camera_key=True)
    start = toy_state(1.1)
    other = objects.add_object(toy_prior(), start)
    pose = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    objects.graph.push_back(gtsam.PriorFactorPose3(other.keys.pose, start.T_world_object, pose))
    expected = [objects.marginals(handle).matrix for handle in objects.objects]
    posterior = objects.posterior()
    objects.values.update(other.keys.log_scale, np.full(3, 0.5))
    for handle, matrix in zip(objects.objects, expected, strict=True):
        np.testing.assert_allclose(posterior.marginals(handle.keys).matrix, matrix, rtol=1e-6, atol=1e-12)
    both = posterior.joint_covariance([other.keys.pose, X(0)])
    np.testing.assert_allclose(both[:6, 6:], 0.0, atol=1e-12)  # they share no factor


def test_an_unknown_camera_makes_the_object_less_certain():
    known, unknown = chair_graph(), chair_graph(camera_key=True)
    more = unknown.marginals(unknown.objects[0]).matrix - known.marginals(known.objects[0]).matrix
    assert np.linalg.eigvalsh(more).min() > -1e-7
    assert np.trace(more) > 0


def test_axes_and_blocks():
    objects = chair_graph()
    covariance = objects.marginals(objects.objects[0])
    assert covariance.source == "marginals"
    assert covariance.axes[:RIGID] == RIGID_AXES == COVARIANCE_AXES
    assert len(covariance.axes) == len(set(covariance.axes)) == RIGID + CODE
    assert covariance.axes[RIGID:] == ("code_0 [1]", "code_1 [1]", "code_2 [1]", "code_3 [1]")
    assert covariance.rigid.shape == (RIGID, RIGID)
    assert covariance.code.shape == (CODE, CODE)
    np.testing.assert_array_equal(covariance.matrix, covariance.matrix.T)
    np.testing.assert_array_equal(covariance.rigid, covariance.matrix[:RIGID, :RIGID])
    np.testing.assert_array_equal(covariance.code, covariance.matrix[RIGID:, RIGID:])
    np.testing.assert_allclose(covariance.sigma**2, np.diag(covariance.matrix))
    assert np.linalg.eigvalsh(covariance.matrix).min() > 0


def test_a_covariance_times_a_factor_keeps_its_meaning():
    covariance = ObjectCovariance.diagonal(np.arange(1.0, 14.0), "marginals", "chair 1")
    wider = covariance.times(2.5)
    assert isinstance(wider, ObjectCovariance)
    np.testing.assert_allclose(wider.sigma, np.sqrt(2.5) * covariance.sigma)
    assert (wider.axes, wider.source, wider.subject) == (covariance.axes, "marginals", "chair 1")
    with pytest.raises(CovarianceError, match="negative variance"):
        covariance.times(-1.0)


def test_each_axis_is_what_its_label_says():
    """An object held by priors alone has their covariance, block by block."""
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values())
    handle = objects.add_object(toy_prior(), toy_state())
    sigmas = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    T = toy_state().T_world_object
    objects.graph.push_back(gtsam.PriorFactorPose3(handle.keys.pose, T, noise))
    covariance = objects.marginals(handle)
    np.testing.assert_allclose(covariance.sigma[:6], sigmas)
    np.testing.assert_allclose(covariance.code, toy_prior().code_covariance)
    # the mean log-scale is as uncertain as the category's sizes, its axes' deviations from it as configured
    scale = covariance.rigid[6:, 6:]
    mean, deviation = np.full(3, 1 / 3), np.array([1, -1, 0]) / np.sqrt(2)
    assert mean @ scale @ mean == pytest.approx(toy_prior().size_log_sigma ** 2)
    assert deviation @ scale @ deviation == pytest.approx(objects.builder.config.anisotropy_sigma**2)
    np.testing.assert_allclose(covariance.matrix[:6, 6:], 0, atol=1e-12)


def lacking(missing: str) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, ObjectKeys]:
    """A chair of which two points are seen, without one of the things that determine it."""
    prior, state, keys = toy_prior(), toy_state(), ObjectKeys.numbered(0)
    view = observe(toy_frame([state], 0.3), 1, SAMPLING).thinned(2, 1)
    seen = ObjectBuilder().alone(prior, state, [view])
    hold = gtsam.PriorFactorPose3(keys.pose, state.T_world_object, gtsam.noiseModel.Isotropic.Sigma(6, 0.01))
    parts = {
        "code": [code_prior(keys, prior.code_mean, prior.code_covariance)],
        "scale": [scale_prior(keys, 0.1, 0.3, 0.1)],
        "views": [upright_prior(keys, UP, 0.03), seen.factors[0].gtsam_factor(), hold],
    }
    if missing == "views":
        parts[missing] = parts[missing][:1]
    else:
        del parts[missing]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for factor in (factor for factors in parts.values() for factor in factors):
        graph.push_back(factor)
    state.insert(values, keys)
    return graph, values, keys


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (
            "views",
            r"does not determine o0 \(translation in every direction of the object frame, m; rotation about y of "
            r"the object frame, rad\): it needs views of the object or a pose prior$",
        ),
        (
            "code",
            r"does not determine z0 \([23] directions of the code, mostly code_.*\): it needs a code prior$",
        ),
        ("scale", r"does not determine s0 \(log_?-?scale.*\): it needs a scale prior$"),
    ],
)
def test_what_is_undetermined_is_named(missing, message):
    with pytest.raises(SolveError, match=message):
        marginals(*lacking(missing))


def test_an_object_without_anything_but_its_priors_lacks_a_pose():
    objects = ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values())
    handle = objects.add_object(toy_prior(), toy_state())
    with pytest.raises(SolveError, match=r"does not determine o0 \(no factor is on it: translation in every"):
        marginals(objects.graph, objects.values, handle.keys)


def test_the_loosest_variable_of_many_is_named():
    """Of 40 poses one is only held level; GTSAM itself would name what it happens to eliminate last."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), noise))
    values.insert(X(0), gtsam.Pose3())
    for i in range(1, 40):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(), np.array([i, 0.3 * i, 0.1])))
        before = X(8 if i == 10 else i - 1)
        if i != 9:
            graph.push_back(gtsam.BetweenFactorPose3(before, X(i), gtsam.Pose3(), noise))
    level = gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
    graph.push_back(gtsam.AttitudeFactorPose3(X(9), level, gtsam.noiseModel.Isotropic.Sigma(2, 0.1), level))
    with pytest.raises(
        SolveError, match=r"does not determine x9 \(translation in every direction .* about z"
    ):
        Posterior(graph, values).joint_covariance([X(1)])


def test_rounding_is_no_information():
    """A direction of the code ten million times less known than the others: a Cholesky factor exists all the same."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(CODE, CODE)))[0]
    code = gtsam.symbol("z", 0)
    for weakest in (1e-3, 1e-7):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        sigmas = np.array([1.0, 1.0, 1.0, 1.0 / weakest])
        noise = gtsam.noiseModel.Gaussian.SqrtInformation(np.diag(1.0 / sigmas) @ turn)
        graph.push_back(gtsam.PriorFactorVector(code, np.zeros(CODE), noise))
        values.insert(code, np.zeros(CODE))
        if weakest == 1e-3:
            covariance = Posterior(graph, values).joint_covariance([code])
            np.testing.assert_allclose(covariance, (turn.T * sigmas**2) @ turn, rtol=1e-4)
        else:
            with pytest.raises(SolveError, match=r"does not determine z0 \(code direction, mostly code_"):
                Posterior(graph, values).joint_covariance([code])


def surface_shift(decoder: ToyDecoder, states, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """How far along `normals` the surface of each of `states` passes by world points, by bisection."""
    low, high = np.full((len(states), len(points)), -0.05), np.full((len(states), len(points)), 0.05)
    for _ in range(16):
        middle = 0.5 * (low + high)
        for i, state in enumerate(states):
            p_object = torch.as_tensor(state.to_object(points + middle[i][:, None] * normals))
            inside = decoder(p_object, torch.as_tensor(state.code)[None]).numpy() < 0
            low[i], high[i] = np.where(inside, middle[i], low[i]), np.where(inside, high[i], middle[i])
    return 0.5 * (low + high)


def flat_places(decoder: ToyDecoder, state) -> tuple[np.ndarray, np.ndarray]:
    """Canonical points on the chair away from its edges, where a first-order statement can hold, and normals."""
    mesh = extract_mesh(decoder, state.code, resolution=24)
    points = np.random.default_rng(0).permutation(mesh.triangles_center)
    jet = decoder.linearize(torch.as_tensor(points), torch.as_tensor(state.code)[None])
    normals = jet.d_point.numpy()
    points = points - jet.value.numpy()[:, None] * normals
    ahead = [
        decoder(torch.as_tensor(points + np.array(d)), torch.as_tensor(state.code)[None]).numpy()
        - (normals @ np.array(d))
        for d in 0.05 * np.concatenate([np.eye(3), -np.eye(3)])
    ]
    flat = np.abs(ahead).max(axis=0) < 1e-3
    return points[flat][:25], normals[flat][:25]


def test_surface_sigma_is_the_spread_of_drawn_surfaces():
    decoder = ToyDecoder().double()
    objects = chair_graph()
    state = objects.state(objects.objects[0])
    # shrunk, so that curvature does not matter
    found = objects.marginals(objects.objects[0])
    covariance = ObjectCovariance(0.05 * found.matrix, found.axes, found.source)
    points, normals = flat_places(decoder, state)
    assert len(points) == 25
    sigma = surface_sigma(decoder, state, covariance, points)
    # normals turn with the inverse of the scale
    n_world = (normals / state.scale) @ state.T_world_object.rotation().matrix().T
    n_world /= np.linalg.norm(n_world, axis=1, keepdims=True)
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(13), covariance.matrix, size=200)
    shifts = surface_shift(decoder, [state.retract(draw) for draw in draws], state.to_world(points), n_world)
    ratio = np.square(shifts).mean(axis=0) / sigma**2
    # a mean of 200 squares is chi-square distributed; two in a million lie outside
    low, high = chi2.ppf([1e-6, 1 - 1e-6], 200) / 200
    assert (ratio > low).all()
    assert (ratio < high).all()
    assert np.ptp(sigma) > 0.2 * sigma.mean()  # the places do differ


def test_surface_sigma_of_one_known_direction():
    """A scale known to one percent moves the surface by one percent of its distance from the centre plane."""
    decoder, state = ToyDecoder(), toy_state()
    matrix = np.zeros((13, 13))
    matrix[6, 6] = 0.01**2
    covariance = ObjectCovariance.of(matrix, "made up")
    points, normals = flat_places(decoder.double(), state)
    sigma = surface_sigma(decoder, state, covariance, points)
    expected = 0.01 * np.abs(points[:, 0] * normals[:, 0]) * state.scale[0]
    np.testing.assert_allclose(sigma, expected, rtol=1e-3, atol=1e-6)
    assert expected.max() > 1e-3


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ([], "keys is empty"),
        ([-1], "a key, from 0"),
        (["x0"], "a key, a whole number"),
        (3, "a list of keys"),
    ],
)
def test_keys_that_are_none_are_told(keys, words):
    with pytest.raises(SolveError, match=words):
        Posterior(*chain(2, held=True)).joint_covariance(keys)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_what_is_not_finite_is_told_by_its_key(number):
    graph, values = chain(3, held=True)
    elsewhere = gtsam.Pose3(gtsam.Rot3(), np.array([number, 0, 0]))
    graph.push_back(gtsam.BetweenFactorPose3(X(1), X(2), elsewhere, gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    with pytest.raises(SolveError, match="the factor on x1, x2 is not finite"):
        Posterior(graph, values)
    values.update(X(2), elsewhere)
    with pytest.raises(SolveError, match="the value of x2 is not finite"):
        Posterior(graph, values)
