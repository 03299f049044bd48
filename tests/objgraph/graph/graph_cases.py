"""A toy chair in an object graph, seen from fixed and from unknown cameras."""

from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from factors.state import ObjectState
from objgraph.graph.builder import GraphConfig
from objgraph.graph.handle import ObjectHandle
from objgraph.graph.object_graph import ObjectGraph
from objgraph.graph.solve import SolverConfig
from objgraph.observation.sampling import SamplingConfig, observe
from tests.toys import TOY_CODE, toy_frame, toy_prior

UP = np.array([0.0, 0.0, 1.0])
SAMPLING = SamplingConfig(points=120, hits=60, free=60)
SHORT = SolverConfig(slopes=(60.0, 200.0), rounds=4)
OFF = np.array([0.05, -0.08, 0.03, 0.02, -0.03, 0.02, 0.05, -0.05, 0.03, -0.3, 0.3, -0.2, 0.1])
NEAR = np.array([0.04, -0.03, 0.05, 0.03, -0.05, 0.04])
"""A camera's error: some degrees, some centimetres."""


def pose_noise(rotation: float, translation: float):
    return gtsam.noiseModel.Diagonal.Sigmas([rotation] * 3 + [translation] * 3)


def empty(config: GraphConfig | None = None, up_world: np.ndarray | None = UP) -> ObjectGraph:
    return ObjectGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), config, up_world=up_world)


def views_of(state: ObjectState, azimuths=(0.3, 2.0)):
    return [observe(toy_frame([state], a, str(i), seed=i), 1, SAMPLING) for i, a in enumerate(azimuths)]


def moved(state: ObjectState, metres: float) -> ObjectState:
    T = state.T_world_object
    return replace(
        state, T_world_object=gtsam.Pose3(T.rotation(), T.translation() + np.array([metres, 0, 0]))
    )


def pose_error(T: gtsam.Pose3, T_true: gtsam.Pose3) -> tuple[float, float]:
    """Radians and metres."""
    between = T_true.between(T)
    angle = np.linalg.norm(gtsam.Rot3.Logmap(between.rotation()))
    return float(angle), float(np.linalg.norm(between.translation()))


def camera_graph(state: ObjectState, T_world_camera: gtsam.Pose3, view) -> tuple[ObjectGraph, ObjectHandle]:
    """An object whose pose is known well, seen from a camera that is not."""
    objects = empty()
    objects.values.insert(X(5), T_world_camera)
    objects.graph.push_back(gtsam.PriorFactorPose3(X(5), T_world_camera, pose_noise(0.1, 0.2)))
    prior = replace(
        toy_prior(), code_covariance=4.5 * np.eye(TOY_CODE)
    )  # the view, not the prior, is to say the code
    handle = objects.add_object(prior, state)
    objects.graph.push_back(
        gtsam.PriorFactorPose3(handle.keys.pose, state.T_world_object, pose_noise(1e-3, 1e-3))
    )
    objects.observe(handle, view, camera=X(5))
    return objects, handle
