"""Problems for the solver: an ellipsoid, a pose graph, a toy chair."""

from dataclasses import replace

import gtsam
import numpy as np
import torch
from gtsam.symbol_shorthand import L, X

from factors.base import Annealing
from factors.priors import code_prior, scale_prior, upright_prior
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.solve import LevenbergMarquardtConfig, Problem, SolverConfig
from objgraph.observation.sampling import SamplingConfig, observe
from tests.toys import TOY_CODE, ToyDecoder, toy_frame, toy_prior, toy_state

UP = np.array([0.0, 0.0, 1.0])
OFF = np.array([0.05, -0.08, 0.03, 0.02, -0.03, 0.02, 0.05, -0.05, 0.03, -0.3, 0.3, -0.2, 0.1])
"""A start: degrees, centimetres and some code away from the truth."""
TIGHT = LevenbergMarquardtConfig(iterations=200, relative_tolerance=1e-10)
SHORT = SolverConfig(slopes=(60.0, 200.0), rounds=4, inner=LevenbergMarquardtConfig(iterations=3))


class EggDecoder(ToyDecoder):
    """An ellipsoid: smooth, so that two solvers must meet in one point."""

    def _network(self, points, injected):
        code = injected["0"]
        stretched = points * (1 + 0.1 * code[:, :3]) * torch.tensor([1.0, 0.7, 1.4], dtype=points.dtype)
        return (stretched.square().sum(dim=1) + 1e-6).sqrt() - 0.3 - 0.02 * code[:, 3]


def egg_problem() -> Problem:
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    state = ObjectState(gtsam.Pose3(gtsam.Rot3.Rx(np.pi / 2), np.zeros(3)), np.zeros(3), np.zeros(4))
    points = state.to_world(0.3 * direction / [1.0, 0.7, 1.4]) + rng.normal(size=(300, 3)) * 0.003
    keys, graph, values = ObjectKeys.numbered(0), gtsam.NonlinearFactorGraph(), gtsam.Values()
    factor = SurfaceFactor(keys, EggDecoder().double(), gtsam.Pose3(), points, np.full(300, 0.003))
    for part in (
        factor.gtsam_factor(),
        code_prior(keys, np.zeros(4), np.eye(4)),
        scale_prior(keys, 0.0, 0.3, 0.1),
        upright_prior(keys, UP, 0.03),
    ):
        graph.push_back(part)
    state.retract(OFF).insert(values, keys)
    factor.refresh(values, Annealing())
    return Problem("egg", graph, values, [factor])


def pose_graph(measured: float = 1.0, prior: bool = True) -> Problem:
    """A square of poses that closes badly, with a landmark seen from two corners."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    if prior:
        graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), noise))
    corner = gtsam.Pose3(gtsam.Rot3.Rz(np.pi / 2), np.array([measured, 0.05, -0.02]))
    for i in range(4):
        graph.push_back(gtsam.BetweenFactorPose3(X(i), X((i + 1) % 4), corner, noise))
        values.insert(
            X(i), gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 1.4 * i), np.array([0.3 * i, 0.5, -0.2]))
        )
    sight = gtsam.noiseModel.Diagonal.Sigmas([0.01, 0.02, 0.05])
    for i in (0, 2):
        bearing = gtsam.Unit3(np.array([1.0, 0.4, 0.2]))
        graph.push_back(gtsam.BearingRangeFactor3D(X(i), L(0), bearing, 0.8, sight))
    values.insert(L(0), np.array([0.7, 0.6, 0.1]))
    return Problem("square", graph, values, [])


def chair_problem(heading: float = 0.4, decoder: ToyDecoder | None = None) -> Problem:
    state, sampling = toy_state(heading), SamplingConfig(points=80, hits=40, free=40)
    views = [
        observe(toy_frame([state], azimuth, seed=i), 1, sampling) for i, azimuth in enumerate((0.3, 2.0))
    ]
    wide = 4.5 * np.eye(TOY_CODE)
    prior = replace(toy_prior(), decoder=decoder or ToyDecoder().double(), code_covariance=wide)
    return ObjectBuilder(up_world=UP).alone(prior, state.retract(OFF), views)


def difference(a: gtsam.Values, b: gtsam.Values) -> float:
    delta = a.localCoordinates(b)
    return max(np.abs(delta.at(key)).max() for key in list(a.keys()))
