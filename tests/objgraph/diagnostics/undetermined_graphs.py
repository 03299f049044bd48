"""Graphs that leave something undetermined, for the tests of diagnostics."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

TENTH = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)


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


def inertial(n: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Poses and velocities by an inertial unit, whose bias is known, and odometry."""
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(1e-4 * np.eye(3))
    params.setGyroscopeCovariance(1e-5 * np.eye(3))
    params.setIntegrationCovariance(1e-8 * np.eye(3))
    graph, values, rng = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.random.default_rng(0)
    bias, state = gtsam.imuBias.ConstantBias(), gtsam.NavState(gtsam.Pose3(), np.array([1.0, 0, 0]))
    values.insert(B(0), bias)
    graph.push_back(gtsam.PriorFactorConstantBias(B(0), bias, TENTH))
    for i in range(n):
        if i:
            measured = gtsam.PreintegratedImuMeasurements(params, bias)
            force, turning = 2 * rng.normal(size=3) + [0, 0, 9.81], 0.5 * rng.normal(size=3)
            for _ in range(50):
                measured.integrateMeasurement(force, turning, 0.01)
            before, state = state, measured.predict(state, bias)
            graph.push_back(gtsam.ImuFactor(X(i - 1), V(i - 1), X(i), V(i), B(0), measured))
            step = before.pose().between(state.pose())
            graph.push_back(gtsam.BetweenFactorPose3(X(i - 1), X(i), step, TENTH))
        values.insert(X(i), state.pose())
        values.insert(V(i), np.array(state.velocity()))
    return graph, values
