"""Where every assumption holds, the marginals are the errors' covariance: poses, scales and codes drawn from their
priors, surfaces the decoder's own, noise as it is modelled, every point one measurement."""

import gtsam
import numpy as np
import torch
from scipy.stats import chi2, kstest

from factors.sdf import MetricSdf, query_points
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from objgraph.covariance.posterior import marginals
from objgraph.graph.builder import GraphConfig, ObjectBuilder
from objgraph.graph.solve import Problem, solve
from objgraph.priors.fallback import fallback_prior
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior

DRAWS, POINTS, NOISE = 200, 150, 0.003
KEYS = ObjectKeys.numbered(0)
CONFIG = GraphConfig()
PLACE = gtsam.Pose3(gtsam.Rot3.Rz(0.4).compose(gtsam.Rot3.Rx(np.pi / 2)), np.array([0.3, 0.2, 0.5]))
PLACE_SIGMAS = np.array([0.05, 0.05, 0.1, 0.05, 0.05, 0.05])


def drawn_state(prior: ShapePrior, rng: np.random.Generator) -> ObjectState:
    code = rng.multivariate_normal(prior.code_mean, prior.code_covariance)
    stretch = (prior.anisotropy_sigma or CONFIG.anisotropy_sigma) * rng.normal(size=3)
    size = np.log(prior.size_mean) + prior.size_log_sigma * rng.normal()
    return ObjectState(
        PLACE.retract(PLACE_SIGMAS * rng.normal(size=6)), size + stretch - stretch.mean(), code
    )


def noisy_points(prior: ShapePrior, state: ObjectState, rng: np.random.Generator) -> np.ndarray:
    """World points whose metric SDF is the noise: walked there along the gradient from the decoder's own mesh."""
    vertices = np.asarray(extract_mesh(prior.decoder, state.code, resolution=32).vertices)
    points = state.to_world(rng.permutation(vertices)[:POINTS])
    noise = torch.as_tensor(rng.normal(size=POINTS) * NOISE)
    for _ in range(6):
        query = query_points(prior.decoder, state, gtsam.Pose3(), points)
        jet = prior.decoder.linearize(query.p_object, query.code[None])
        metric = MetricSdf.of(jet.d_point, state)
        normal = torch.nn.functional.normalize(jet.d_point.double() / torch.as_tensor(state.scale), dim=1)
        off = metric.metres * jet.value.double() - noise
        points = points - (off[:, None] * normal).numpy() @ state.T_world_object.rotation().matrix().T
    return points


def solved(prior: ShapePrior, truth: ObjectState, points: np.ndarray) -> Problem:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factor = SurfaceFactor(KEYS, prior.decoder, gtsam.Pose3(), points, np.full(POINTS, NOISE))
    for part in (*ObjectBuilder(CONFIG).priors(prior, KEYS), factor.gtsam_factor()):
        graph.push_back(part)
    place = gtsam.noiseModel.Diagonal.Sigmas(PLACE_SIGMAS)
    graph.push_back(gtsam.PriorFactorPose3(KEYS.pose, PLACE, place))
    truth.insert(values, KEYS)
    problem = Problem("object", graph, values, [factor])
    solve([problem])
    return problem


def squared_errors(prior: ShapePrior, seed: int) -> list[float]:
    """Of pose and scale, and of all, in units of the covariance."""
    rng = np.random.default_rng(seed)
    truth = drawn_state(prior, rng)
    problem = solved(prior, truth, noisy_points(prior, truth, rng))
    covariance = marginals(problem.graph, problem.values, KEYS).matrix
    found = ObjectState.from_values(problem.values, KEYS)
    moved = found.T_world_object.localCoordinates(truth.T_world_object)
    error = np.concatenate([moved, truth.log_scale - found.log_scale, truth.code - found.code])
    return [float(error[:n] @ np.linalg.solve(covariance[:n, :n], error[:n])) for n in (9, len(error))]


def test_normalised_errors_follow_chi_squared():
    prior = fallback_prior("chair")
    squared = np.array([squared_errors(prior, seed) for seed in range(DRAWS)])
    for errors, dof in zip(squared.T, (9, 9 + len(prior.code_mean)), strict=True):
        assert errors.mean() > 0.5 * dof  # it was solved, and did not stay at the truth
        assert kstest(errors, chi2(dof).cdf).pvalue > 0.01
